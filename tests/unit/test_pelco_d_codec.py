"""Every byte of Pelco-D: commands against published vectors, replies, framing traps, and noise."""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.errors import InputError
from camrig_drivers.pelco_d import commands as pelco
from camrig_drivers.pelco_d.codec import (
    Axis,
    Command,
    Device,
    Echo,
    Extended,
    FrameError,
    General,
    Op,
    Reply,
    Request,
    decode,
    decode_extended,
    decode_general,
    encode,
    find_reply,
)
from camrig_drivers.pelco_d.commands import PELCO, Dialect, drive, extended, query_position, set_position, switch

Params = Mapping[str, Any]


def _special(op: Op, preset: int) -> Command:
    return extended(op, preset, allow_special=True)


BUILDERS: dict[str, Callable[[Params], Command]] = {
    "stop": lambda p: pelco.STOP,
    "pan_left": lambda p: drive(-p["pan_speed"], 0),
    "pan_right": lambda p: drive(p["pan_speed"], 0),
    "tilt_up": lambda p: drive(0, p["tilt_speed"]),
    "tilt_down": lambda p: drive(0, -p["tilt_speed"]),
    "up_left": lambda p: drive(-p["pan_speed"], p["tilt_speed"]),
    "up_right": lambda p: drive(p["pan_speed"], p["tilt_speed"]),
    "down_left": lambda p: drive(-p["pan_speed"], -p["tilt_speed"]),
    "down_right": lambda p: drive(p["pan_speed"], -p["tilt_speed"]),
    "zoom_tele": lambda p: pelco.ZOOM_TELE,
    "zoom_wide": lambda p: pelco.ZOOM_WIDE,
    "focus_far": lambda p: pelco.FOCUS_FAR,
    "focus_near": lambda p: pelco.FOCUS_NEAR,
    "iris_open": lambda p: pelco.IRIS_OPEN,
    "iris_close": lambda p: pelco.IRIS_CLOSE,
    "camera_on": lambda p: pelco.CAMERA_ON,
    "camera_off": lambda p: pelco.CAMERA_OFF,
    "auto_scan": lambda p: pelco.AUTO_SCAN,
    "manual_scan": lambda p: pelco.MANUAL_SCAN,
    "remote_reset": lambda p: extended(Op.REMOTE_RESET),
    "zone_scan_on": lambda p: extended(Op.ZONE_SCAN_ON),
    "zone_scan_off": lambda p: extended(Op.ZONE_SCAN_OFF),
    "reset_defaults": lambda p: extended(Op.RESET_DEFAULTS),
    "phase_delay": lambda p: extended(Op.PHASE_DELAY),
    "set_zero": lambda p: extended(Op.SET_ZERO),
    "query_pan": lambda p: query_position(Axis.PAN),
    "query_tilt": lambda p: query_position(Axis.TILT),
    "query_zoom": lambda p: query_position(Axis.ZOOM),
    "query_mag": lambda p: extended(Op.QUERY_MAGNIFICATION),
    "query_device": lambda p: extended(Op.QUERY_DEVICE),
    "query_device_type": lambda p: extended(Op.QUERY_DEVICE_TYPE),
    "query_diag": lambda p: extended(Op.QUERY_DIAGNOSTICS),
    "dummy": lambda p: extended(Op.DUMMY),
    "set_preset": lambda p: _special(Op.SET_PRESET, p["preset"]),
    "clear_preset": lambda p: _special(Op.CLEAR_PRESET, p["preset"]),
    "goto_preset": lambda p: _special(Op.CALL_PRESET, p["preset"]),
    "flip": lambda p: _special(Op.CALL_PRESET, 33),
    "zero_pan": lambda p: _special(Op.CALL_PRESET, 34),
    "set_aux": lambda p: extended(Op.SET_AUX, p["id"]),
    "clear_aux": lambda p: extended(Op.CLEAR_AUX, p["id"]),
    "zone_start": lambda p: extended(Op.ZONE_START, p["id"]),
    "zone_end": lambda p: extended(Op.ZONE_END, p["id"]),
    "write_char": lambda p: pelco.write_char(p["column"], p["char"]),
    "clear_screen": lambda p: extended(Op.CLEAR_SCREEN),
    "alarm_ack": lambda p: extended(Op.ALARM_ACK, p["id"]),
    "pattern_start": lambda p: extended(Op.PATTERN_START, p["id"]),
    "pattern_stop": lambda p: extended(Op.PATTERN_STOP, p["id"]),
    "run_pattern": lambda p: extended(Op.RUN_PATTERN, p["id"]),
    "zoom_speed": lambda p: extended(Op.ZOOM_SPEED, p["speed"]),
    "focus_speed": lambda p: extended(Op.FOCUS_SPEED, p["speed"]),
    "auto_focus_auto": lambda p: switch(Op.AUTO_FOCUS, on=True),
    "auto_iris_auto": lambda p: switch(Op.AUTO_IRIS, on=True),
    "agc_auto": lambda p: switch(Op.AGC, on=True),
    "awb_on": lambda p: switch(Op.AWB, on=True),
    "awb_off": lambda p: switch(Op.AWB, on=False),
    "shutter": lambda p: extended(Op.SHUTTER, p["value"]),
    "gain_new": lambda p: extended(Op.GAIN, p["value"]),
    "iris_level_new": lambda p: extended(Op.IRIS_LEVEL, p["value"]),
    "iris_peak_new": lambda p: extended(Op.IRIS_PEAK, p["value"]),
    "wb_rb_new": lambda p: extended(Op.WB_RB, p["value"]),
    "wb_mg_new": lambda p: extended(Op.WB_MG, p["value"]),
    "line_lock_new": lambda p: extended(Op.LINE_LOCK, p["value"]),
    "set_pan_position": lambda p: set_position(Axis.PAN, p["raw"]),
    "set_tilt_position": lambda p: set_position(Axis.TILT, p["raw"]),
    "set_zoom_position": lambda p: set_position(Axis.ZOOM, p["raw"]),
}

CONTESTED: dict[str, tuple[Callable[[Dialect], Command], str]] = {
    "pan_left_turbo": (lambda d: drive(-pelco.TURBO, 0, d), "turbo"),
    "auto_focus_off": (lambda d: switch(Op.AUTO_FOCUS, on=False, dialect=d), "auto_off"),
    "auto_iris_off": (lambda d: switch(Op.AUTO_IRIS, on=False, dialect=d), "auto_off"),
    "agc_off": (lambda d: switch(Op.AGC, on=False, dialect=d), "auto_off"),
    "blc_on": (lambda d: switch(Op.BLC, on=True, dialect=d), "blc_on"),
    "blc_off": (lambda d: switch(Op.BLC, on=False, dialect=d), "blc_off"),
    "set_mag_500": (lambda d: pelco.set_magnification(500, d), "magnification_msb"),
}
VALUES: dict[str, tuple[object, ...]] = {
    "turbo": (0x40, 0xFF),
    "auto_off": (0, 1, 2),
    "blc_on": (1, 2),
    "blc_off": (0, 1, 2),
    "magnification_msb": (True, False),
}


@pytest.fixture(scope="module")
def vectors(shared_data: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((shared_data / "pelco_d_vectors.json").read_text())
    return found


def _request(command: Command, address: int = 1) -> Request:
    return Request(address, command)


QUERY_PAN = _request(query_position(Axis.PAN))
STOP_1 = _request(pelco.STOP)


# --- commands -------------------------------------------------------------------------------------------------


def test_all_published_commands_byte_for_byte(vectors: dict[str, Any]) -> None:
    wrong = {
        entry["id"]: encode(entry["params"]["address"], BUILDERS[entry["name"]](entry["params"])).hex()
        for entry in vectors["commands"]
        if encode(entry["params"]["address"], BUILDERS[entry["name"]](entry["params"])).hex() != entry["hex"]
    }
    assert len(vectors["commands"]) == 108
    assert wrong == {}


def test_every_contested_command_is_a_dialect(vectors: dict[str, Any]) -> None:
    for entry in vectors["contested_do_not_hardcode"]:
        build, key = CONTESTED[entry["name"]]
        ours = {encode(1, build(Dialect.model_validate({key: value}))).hex() for value in VALUES[key]}
        assert {variant["hex"] for variant in entry["variants"]} <= ours, entry["name"]


@pytest.mark.parametrize(
    ("address", "command", "frame"),
    [
        (1, pelco.STOP, "ff010000000001"),
        (254, pelco.STOP, "fffe00000000fe"),
        (1, drive(-32, 0), "ff010004200025"),
        (10, drive(63, 0), "ff0a00023f004b"),
        (1, drive(0, 1), "ff01000800010a"),
        (1, drive(0, -63), "ff010010003f50"),
        (1, drive(-32, 16), "ff01000c20103d"),
        (1, drive(63, -63), "ff0100123f3f91"),
        (1, pelco.FOCUS_NEAR, "ff010100000002"),
        (1, pelco.CAMERA_OFF, "ff010800000009"),
        (1, pelco.AUTO_SCAN, "ff019000000091"),
        (1, extended(Op.DUMMY), "ff01000d00000e"),
        (12, extended(Op.CALL_PRESET, 15), "ff0c0007000f22"),
        (1, extended(Op.SET_PRESET, 255), "ff01000300ff03"),
        (1, pelco.write_char(39, "A"), "ff01001527417e"),
        (1, switch(Op.AUTO_FOCUS, on=True), "ff01002b00002c"),
        (1, switch(Op.AUTO_FOCUS, on=False), "ff01002b00012d"),
        (1, switch(Op.AUTO_FOCUS, on=True, dialect=Dialect(auto_on=2)), "ff01002b00022e"),
        (1, switch(Op.AWB, on=False, dialect=Dialect(awb_off=0)), "ff010033000034"),
        (1, switch(Op.BLC, on=True), "ff010031000234"),
        (1, drive(-64, 0, Dialect(turbo=0x40)), "ff010004400045"),
        (1, drive(-64, 0, Dialect(turbo=0xFF)), "ff010004ff0004"),
        (1, pelco.set_magnification(500), "ff01005f01f455"),
        (1, extended(Op.SHUTTER, 0x1234), "ff01003712347e"),
        (1, set_position(Axis.PAN, 0), "ff01004b00004c"),
        (1, set_position(Axis.PAN, 255), "ff01004b00ff4b"),
        (1, set_position(Axis.PAN, 35999), "ff01004b8c9f77"),
        (10, set_position(Axis.PAN, 18000), "ff0a004b4650eb"),
        (1, set_position(Axis.TILT, 34500), "ff01004d86c498"),
        (1, set_position(Axis.ZOOM, 65535), "ff01004fffff4e"),
        (1, query_position(Axis.PAN), "ff010051000052"),
        (1, query_position(Axis.TILT), "ff010053000054"),
        (1, extended(Op.QUERY_DEVICE), "ff010045000046"),
    ],
)
def test_commands_byte_for_byte(address: int, command: Command, frame: str) -> None:
    assert encode(address, command).hex() == frame


@pytest.mark.parametrize(("raw", "sent"), [(36000, 0), (-1, 35999), (-4500, 31500), (72001, 1)])
def test_a_set_angle_is_wrapped_into_one_turn(raw: int, sent: int) -> None:
    assert set_position(Axis.PAN, raw) == set_position(Axis.PAN, sent)
    assert set_position(Axis.TILT, raw) == set_position(Axis.TILT, sent)


@pytest.mark.parametrize("preset", [33, 34, 84, 95, 105])
@pytest.mark.parametrize("op", [Op.SET_PRESET, Op.CLEAR_PRESET, Op.CALL_PRESET])
def test_presets_that_are_orders_are_refused(op: Op, preset: int) -> None:
    with pytest.raises(InputError, match=f"preset {preset} is an order"):
        extended(op, preset)


@pytest.mark.parametrize("preset", [1, 32, 35, 83, 106, 255])
def test_other_presets_are_not(preset: int) -> None:
    assert extended(Op.CALL_PRESET, preset).data2 == preset


@pytest.mark.parametrize(
    "refused",
    [
        lambda: drive(65, 0, Dialect(turbo=0x40)),
        lambda: drive(0, 64),
        lambda: drive(64, 0),
        lambda: extended(Op.CALL_PRESET, 0),
        lambda: extended(Op.SET_AUX, 9),
        lambda: extended(Op.ZOOM_SPEED, 4),
        lambda: extended(Op.SET_PAN, 36000),
        lambda: set_position(Axis.ZOOM, -1),
        lambda: extended(Op.REMOTE_RESET, 1),
        lambda: pelco.write_char(40, "A"),
        lambda: pelco.write_char(0, "é"),
        lambda: encode(256, pelco.STOP),
        lambda: encode(1, Command(0, 0, -1, 0)),
    ],
)
def test_what_no_head_understands_is_refused(refused: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        refused()


def test_no_motion_ever_has_a_direction_with_speed_0_or_a_camera_bit() -> None:
    for pan in range(-63, 64):
        for tilt in (-63, -1, 0, 1, 63):
            command = drive(pan, tilt)
            assert command.word1 == 0
            assert bool(command.word2 & 0x06) == bool(command.data1)
            assert bool(command.word2 & 0x18) == bool(command.data2)


@given(address=st.integers(0, 255), fields=st.tuples(*[st.integers(0, 255)] * 4))
def test_encode_and_decode_are_inverse(address: int, fields: tuple[int, int, int, int]) -> None:
    assert decode(encode(address, Command(*fields))) == (address, Command(*fields))


# --- replies --------------------------------------------------------------------------------------------------

REPLIES: list[tuple[Request, str, Reply]] = [
    (QUERY_PAN, "ff010059814a25", Extended(1, Op.PAN, 0x81, 0x4A)),
    (QUERY_PAN, "ff0100593039c3", Extended(1, Op.PAN, 0x30, 0x39)),
    (_request(query_position(Axis.TILT)), "ff01005b11d744", Extended(1, Op.TILT, 0x11, 0xD7)),
    (_request(query_position(Axis.ZOOM)), "ff01005d04b012", Extended(1, Op.ZOOM, 0x04, 0xB0)),
    (_request(extended(Op.QUERY_DEVICE_TYPE)), "ff01006d050275", Extended(1, Op.DEVICE_TYPE, 5, 2)),
    (_request(drive(63, 0)), "ff010042", General(1, ())),
    (_request(extended(Op.QUERY_DEVICE)), "ff01" + "41" * 15 + "16", Device(1, b"A" * 15)),
]


@pytest.mark.parametrize(("request_", "received", "reply"), REPLIES)
def test_replies_of_4_7_and_18_bytes(request_: Request, received: str, reply: Reply) -> None:
    data = bytes.fromhex(received)
    assert [find_reply(data[:count], request_) for count in range(len(data))] == [None] * len(data)
    assert find_reply(data, request_) == reply


def test_a_position_is_both_data_bytes() -> None:
    assert decode_extended(bytes.fromhex("ff010059814a25"), QUERY_PAN).value == 33098


def test_all_published_replies(vectors: dict[str, Any]) -> None:
    asked = {
        "pan": query_position(Axis.PAN),
        "tilt": query_position(Axis.TILT),
        "zoom": query_position(Axis.ZOOM),
        "device_type": extended(Op.QUERY_DEVICE_TYPE),
    }
    for entry in vectors["replies"]:
        data, want = bytes.fromhex(entry["hex"]), entry["decode"]
        if want["kind"] == "general":
            sent = _request(Command(0x00, 0x02, (int(entry["sent_checksum"], 16) - 3) % 256))
            assert decode_general(data, sent) == General(want["address"], tuple(want["alarms"]))
        else:
            reply = find_reply(data, _request(asked[want["kind"]]))
            assert isinstance(reply, Extended)
            assert (reply.value, reply.data1, reply.data2) == (
                want.get("raw", reply.value),
                want.get("software", reply.data1),
                want.get("hardware", reply.data2),
            )


def test_a_general_reply_is_checked_against_the_command_it_answers() -> None:
    alarms_1_3_7 = bytes.fromhex("ff0145a8")
    sent_63 = _request(Command(0x00, 0x02, 0x60, 0x00))
    assert decode_general(alarms_1_3_7, sent_63) == General(1, (1, 3, 7))
    with pytest.raises(FrameError, match="wrong checksum"):
        decode_general(alarms_1_3_7, QUERY_PAN)


def test_the_deviant_own_sum_is_recognised_flagged_and_believed_only_in_silence() -> None:
    own_sum = bytes.fromhex("ff010506")
    flagged = General(1, (1, 3), own_sum=True)
    assert decode_general(own_sum, QUERY_PAN) == flagged
    request = _request(extended(Op.DUMMY))
    assert find_reply(own_sum, request) is None
    assert find_reply(own_sum, request, final=True) == flagged


# --- framing traps --------------------------------------------------------------------------------------------


def test_ff_inside_a_payload_does_not_end_a_frame() -> None:
    assert decode(bytes.fromhex("ff01004b00ff4b")) == (1, set_position(Axis.PAN, 255))
    pan_2_55 = encode(1, Command(0, Op.PAN, 0x00, 0xFF))
    reply = find_reply(pan_2_55, QUERY_PAN)
    assert isinstance(reply, Extended)
    assert reply.value == 255


def test_an_address_may_be_ff() -> None:
    assert decode(bytes.fromhex("ffff000700ff05")) == (255, Command(0, Op.CALL_PRESET, 0, 255))


def test_the_first_four_bytes_of_a_7_byte_ack_are_no_reply_to_a_query() -> None:
    ack = bytes.fromhex("ff01000107010a")
    assert [find_reply(ack[:count], QUERY_PAN) for count in range(8)] == [None] * 8
    dummy = _request(extended(Op.DUMMY))
    assert [find_reply(ack[:count], dummy) for count in range(8)] == [None] * 8
    assert find_reply(ack, dummy, final=True) is None


def test_a_bad_checksum_is_rejected() -> None:
    with pytest.raises(FrameError, match="wrong checksum"):
        decode(bytes.fromhex("ff010051000000"))
    assert find_reply(bytes.fromhex("ff010059814a26"), QUERY_PAN, final=True) is None


@pytest.mark.parametrize("tail", ["010059814a25", "0059814a25", "59814a25"])
def test_a_reply_without_its_head_is_believed_on_request_only_and_flagged(tail: str) -> None:
    data = bytes.fromhex(tail)
    assert find_reply(data, QUERY_PAN, final=True) is None
    assert find_reply(data, QUERY_PAN, resync_tail=True) is None, "more may come"
    degraded = find_reply(data, QUERY_PAN, resync_tail=True, final=True)
    assert degraded == Extended(1, Op.PAN, 0x81, 0x4A, degraded=True)


@pytest.mark.parametrize("not_a_tail", ["814a25", "0059814a26", "005b814a25", "aa0059814a25", "020059814a25"])
def test_other_leftovers_are_not(not_a_tail: str) -> None:
    assert find_reply(bytes.fromhex(not_a_tail), QUERY_PAN, resync_tail=True, final=True) is None


@pytest.mark.parametrize("echo", [Echo.AUTO, Echo.YES])
def test_our_own_echo_is_dropped_exactly(echo: Echo) -> None:
    data = bytes.fromhex("ff010051000052ff010059814a25")
    found = [find_reply(data[:count], QUERY_PAN, echo=echo) for count in range(15)]
    assert found == [None] * 14 + [Extended(1, Op.PAN, 0x81, 0x4A)]


def test_an_echo_is_never_a_general_reply() -> None:
    request = _request(set_position(Axis.PAN, 0xFF))
    assert request.frame.hex() == "ff01004b00ff4b", "its first four bytes pass as a general reply"
    assert [find_reply(request.frame[:count], request) for count in range(8)] == [None] * 8
    assert find_reply(request.frame + bytes.fromhex("ff01004b"), request) == General(1, ())
    assert find_reply(bytes.fromhex("ff01004b"), request, final=True) == General(1, ())
    assert find_reply(bytes.fromhex("ff01004b"), request, echo=Echo.YES, final=True) is None


@pytest.mark.parametrize(
    "foreign",
    [
        "ff020059814a26",  # another head's pan
        "ff01005b814a27",  # our tilt, late
        "ff010159814a26",  # response byte not 0
        "ff010059ffff58",  # 655.35 deg
    ],
)
def test_what_does_not_answer_the_question_is_skipped(foreign: str) -> None:
    data = bytes.fromhex(foreign)
    assert find_reply(data, QUERY_PAN, final=True) is None
    assert find_reply(data + bytes.fromhex("ff0100593039c3"), QUERY_PAN) == Extended(1, Op.PAN, 0x30, 0x39)


# --- noise ----------------------------------------------------------------------------------------------------

ADDRESSES = st.integers(1, 254)
POSITIONS = st.integers(0, 36000)


def _position_frame(address: int, op: int, raw: int) -> bytes:
    body = bytes((address, 0, op, raw >> 8, raw & 0xFF))
    return b"\xff" + body + bytes((sum(body) % 256,))


@given(received=st.binary(max_size=40), address=ADDRESSES, echo=st.sampled_from(Echo), final=st.booleans())
def test_noise_is_never_a_position(received: bytes, address: int, echo: Echo, final: bool) -> None:
    reply = find_reply(received, _request(query_position(Axis.PAN), address), echo=echo, final=final)
    if reply is not None:
        assert isinstance(reply, Extended)
        assert _position_frame(address, 0x59, reply.value) in received


@given(
    received=st.binary(max_size=40) | st.lists(st.sampled_from([0xFF, 0x00, 0x01, 0x59]), max_size=40).map(bytes),
    command=st.sampled_from([pelco.STOP, extended(Op.QUERY_DEVICE), query_position(Axis.TILT)]),
    tail=st.booleans(),
    final=st.booleans(),
)
def test_no_bytes_raise(received: bytes, command: Command, tail: bool, final: bool) -> None:
    find_reply(received, _request(command), resync_tail=tail, final=final)


@given(frame=st.binary(max_size=20))
def test_strict_decoders_raise_nothing_but_their_error(frame: bytes) -> None:
    for strict in (
        lambda: decode(frame),
        lambda: decode_extended(frame, QUERY_PAN),
        lambda: decode_general(frame, STOP_1),
    ):
        with suppress(FrameError):
            strict()


@given(address=ADDRESSES, raw=POSITIONS, at=st.integers(0, 6), flip=st.integers(1, 255))
def test_one_wrong_byte_anywhere_is_noticed(address: int, raw: int, at: int, flip: int) -> None:
    frame = bytearray(_position_frame(address, 0x59, raw))
    frame[at] ^= flip
    assert find_reply(bytes(frame), _request(query_position(Axis.PAN), address), final=True) is None


@given(
    address=ADDRESSES,
    raw=POSITIONS,
    echoed=st.booleans(),
    noise=st.binary(max_size=6).filter(lambda noise: 0xFF not in noise),
    late=st.integers(0, 35999),
)
def test_a_reply_is_found_at_its_last_byte_behind_echo_noise_and_late_frames(
    address: int, raw: int, echoed: bool, noise: bytes, late: int
) -> None:
    request = _request(query_position(Axis.PAN), address)
    before = (request.frame if echoed else b"") + noise + _position_frame(address, 0x5B, late)
    data = before + _position_frame(address, 0x59, raw)
    assert all(find_reply(data[:count], request) is None for count in range(len(data)))
    reply = find_reply(data, request)
    assert isinstance(reply, Extended)
    assert reply.value == raw


def test_the_default_dialect_sends_no_turbo() -> None:
    assert PELCO.turbo is None
