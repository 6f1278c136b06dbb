"""Frames on the wire: golden bytes, garbage between them, frames cut in two."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_drivers.mavlink.codec import Decoder, Encoder
from camrig_drivers.mavlink.commands import take_off
from camrig_drivers.mavlink.packets import (
    Attitude,
    CommandAck,
    Estimator,
    ExtendedState,
    GimbalAttitude,
    GlobalOrigin,
    Heartbeat,
    LocalPosition,
    OwnHeartbeat,
    ParamValue,
    PositionTarget,
    StatusText,
    SystemStatus,
    TimeSync,
    Version,
)

MESSAGES: list[tuple[Any, object]] = [
    (dialect.MAVLink_heartbeat_message(2, 3, 209, 4, 4, 3), Heartbeat(3, 209, 4)),
    (dialect.MAVLink_attitude_message(1234, 0.25, -0.5, 1.5, 0, 0, 0), Attitude(1234, 0.25, -0.5, 1.5)),
    (
        dialect.MAVLink_local_position_ned_message(77, 1, 2, -3, 0.5, 0.25, -0.5),
        LocalPosition(77, (1.0, 2.0, -3.0), (0.5, 0.25, -0.5)),
    ),
    (dialect.MAVLink_extended_sys_state_message(0, 2), ExtendedState(2)),
    (dialect.MAVLink_sys_status_message(7, 6, 5, 0, 0, 0, 50, *[0] * 6), SystemStatus(7, 6, 5, 0.5)),
    (dialect.MAVLink_sys_status_message(7, 6, 5, 0, 0, 0, -1, *[0] * 6), SystemStatus(7, 6, 5, None)),
    (dialect.MAVLink_param_value_message(b"GUID_TIMEOUT", 0.5, 9, 900, 12), ParamValue("GUID_TIMEOUT", 0.5, 9)),
    (dialect.MAVLink_timesync_message(5, 7), TimeSync(5, 7)),
    (dialect.MAVLink_ekf_status_report_message(831, 0.1, 0.5, 0.25, 2.0, 0.0), Estimator(831, 0.5)),
    (dialect.MAVLink_estimator_status_message(1, 831, 0.25, 0.5, math.nan, 2, 0, 0, 0, 0), Estimator(831, 0.5)),
    (dialect.MAVLink_gps_global_origin_message(473977420, 85455940, 488000), GlobalOrigin(47.397742, 8.545594, 488.0)),
    (
        dialect.MAVLink_autopilot_version_message(128, 0x04070100, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0),
        Version(128, 0x04070100),
    ),
    (
        dialect.MAVLink_gimbal_device_attitude_status_message(0, 0, 9, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0),
        GimbalAttitude(0.0),
    ),
    (dialect.MAVLink_command_ack_message(400, 4, 0, 0, 255, 190), CommandAck(400, 4, (255, 190))),
    (dialect.MAVLink_statustext_message(2, b"Arm: no", 0, 0), StatusText(2, "Arm: no", 0, 0)),
]


def frame(message: Any, *, version_1: bool = False) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, 1, 1), force_mavlink1=version_1))


def decoded(data: bytes) -> list[object]:
    return [packet for _, packet in Decoder().feed(data)]


@pytest.mark.parametrize(("message", "packet"), MESSAGES)
def test_every_message_we_listen_to(message: Any, packet: object) -> None:
    assert list(Decoder().feed(frame(message))) == [((1, 1), packet)]


def test_version_1_is_understood() -> None:
    assert decoded(frame(MESSAGES[0][0], version_1=True)) == [MESSAGES[0][1]]


def test_own_heartbeat_is_the_ground_station_255_190() -> None:
    encoder = Encoder()
    assert encoder.encode(OwnHeartbeat(), (0, 0))[:-2].hex() == (
        "fd090000" + "00" + "ff" + "be" + "000000" + "00000000" + "06" + "08" + "00" + "04" + "03"
    )
    assert encoder.encode(OwnHeartbeat(), (0, 0))[4] == 1  # the sequence counts on


def test_set_point_is_frame_1_mask_9f8() -> None:
    sent = dialect.MAVLink(None).decode(bytearray(Encoder().encode(PositionTarget((1.0, 2.0, -2.0), 0.5), (7, 1))))
    assert (sent.target_system, sent.target_component, sent.coordinate_frame, sent.type_mask) == (7, 1, 1, 0x9F8)
    assert (sent.x, sent.y, sent.z, sent.yaw) == (1.0, 2.0, -2.0, 0.5)


def test_take_off_height_is_parameter_7() -> None:
    sent = dialect.MAVLink(None).decode(bytearray(Encoder().encode(take_off(1.5), (1, 1))))
    assert (sent.command, sent.param7, sent.confirmation) == (22, 1.5, 0)
    assert math.isnan(sent.param4)


def test_message_that_nobody_knows_is_passed_over() -> None:
    unknown = bytearray(frame(MESSAGES[0][0]))
    unknown[7:10] = b"\xe8\x2f\x01"  # message 77800
    assert decoded(bytes(unknown) + frame(MESSAGES[1][0])) == [MESSAGES[1][1]]


def test_position_that_is_no_number_is_passed_over() -> None:
    assert decoded(frame(dialect.MAVLink_local_position_ned_message(1, math.nan, 0, 0, 0, 0, 0))) == []


@given(st.lists(st.sampled_from(MESSAGES), min_size=1, max_size=6), st.lists(st.integers(1, 60), max_size=20))
def test_frames_may_be_cut_anywhere(sent: list[tuple[Any, object]], cuts: list[int]) -> None:
    data = b"".join(frame(message) for message, _ in sent)
    decoder, heard = Decoder(), []
    for cut in [*cuts, len(data)]:
        heard += [packet for _, packet in decoder.feed(data[:cut])]
        data = data[cut:]
    assert heard == [packet for _, packet in sent]


@given(st.binary(max_size=300))
@example(b"\xfeP\x00\x00")  # claims 84 bytes of an unknown message, which four heartbeats fill exactly
def test_garbage_costs_itself_alone(garbage: bytes) -> None:
    """Whatever came before: frames enough to fill the longest length that garbage can claim are all heard at last."""
    good = frame(MESSAGES[0][0])
    decoder = Decoder()
    heard = [packet for _, packet in decoder.feed(garbage + good * 20)]
    assert heard[-20:] == [MESSAGES[0][1]] * 20


@pytest.mark.parametrize("index", range(6, 60, 7))
def test_flipped_bit_loses_one_frame(index: int) -> None:
    data = bytearray(frame(MESSAGES[1][0]) + frame(MESSAGES[2][0]))
    data[index] ^= 0x10
    assert len(decoded(bytes(data) + frame(MESSAGES[0][0]))) == 2
