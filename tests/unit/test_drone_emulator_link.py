"""The emulated drone's MAVLink beside flying: links, clocks, parameters, faults, and whatever may arrive."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.errors import InputError
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.protocol import MavlinkProtocol
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.mavlink_drone import MavlinkDroneSettings
from tests.drone_pilot import (
    ACCEPTED,
    ARM,
    FAILED,
    HERE,
    LAND,
    REQUEST,
    SET_INTERVAL,
    SET_MODE,
    START_S,
    Pilot,
    command_long,
    set_point,
)

FLAVOURS = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
NUMBERS = st.one_of(st.floats(width=32), st.sampled_from([0.0, 1.0, 4.0, 6.0, 21196.0, math.nan, math.inf]))


@FLAVOURS
def test_telemetry_ends_five_seconds_after_the_last_word(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.wait(0.1)
    pilot.beats = False
    pilot.wait(10.0)
    last_s = max(stamp_s for stamp_s, _ in pilot.heard)
    assert last_s - START_S == pytest.approx(5.0, abs=1.1)


def test_a_target_is_told_for_ever_and_before_it_says_anything() -> None:
    vehicle = Vehicle(MavlinkDroneSettings(), START_S, 0)
    protocol = MavlinkProtocol(vehicle, Faults(), 0, target=HERE)
    heard = [address for i in range(200) for address, _ in protocol.poll(START_S + 0.1 * i)]
    assert len(heard) > 20
    assert set(heard) == {HERE}


@FLAVOURS
def test_its_clock_can_be_asked(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.wait(1.0)
    pilot.say(dialect.MAVLink_timesync_message(0, 123_456_789))
    answer = pilot.last("TIMESYNC")
    assert answer.ts1 == 123_456_789
    assert answer.tc1 == round((pilot.now_s - pilot.vehicle.boot_s) * 1e9)
    pilot.command(SET_INTERVAL, 32, 1e5)
    pilot.wait(1.0)
    assert pilot.last("LOCAL_POSITION_NED").time_boot_ms == pytest.approx(answer.tc1 / 1e6 + 1000.0, abs=120.0)
    assert Pilot(flavour, seed=1).vehicle.boot_s != pilot.vehicle.boot_s


@FLAVOURS
def test_single_messages_on_request(flavour: str) -> None:
    pilot = Pilot(flavour)
    assert pilot.command(REQUEST, 148) == [ACCEPTED]
    assert pilot.last("AUTOPILOT_VERSION").capabilities & 0x80  # local set-points
    assert pilot.command(REQUEST, 242) == [ACCEPTED]
    home = pilot.last("HOME_POSITION")
    assert (home.x, home.y, home.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert home.altitude == pytest.approx(488_000, abs=50)
    assert pilot.command(REQUEST, 9999) == [FAILED]
    assert pilot.command(SET_INTERVAL, 9999, 1e6) == [FAILED]


def test_home_is_where_it_was_armed_and_the_origin_is_not() -> None:
    pilot = Pilot("ardupilot", start_position_m=(3.0, 1.0, 0.0), origin_m=(1.0, -1.0, 0.5))
    pilot.take_off(1.5)
    pilot.command(REQUEST, 242)
    home = pilot.last("HOME_POSITION")
    assert (home.x, home.y, home.z) == pytest.approx((2.0, 2.0, 0.5), abs=0.05)
    assert pilot.last("LOCAL_POSITION_NED").z == pytest.approx(-1.0, abs=0.15)
    pilot.command(REQUEST, 33)
    assert pilot.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(1500, abs=150)


@FLAVOURS
def test_parameters_are_listed_whole(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.say(dialect.MAVLink_param_request_list_message(1, 1))
    values = pilot.since(0.0, "PARAM_VALUE")
    assert [value.param_index for value in values] == list(range(values[0].param_count))
    pilot.say(dialect.MAVLink_param_request_read_message(1, 1, b"", 2))
    assert pilot.last("PARAM_VALUE").param_id == values[2].param_id
    count = len(pilot.heard)
    pilot.say(dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    assert len(pilot.heard) == count


def test_ardupilots_integers_are_cast() -> None:
    pilot = Pilot("ardupilot")
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 5.0, 2))
    assert pilot.last("PARAM_VALUE").param_value == 5.0
    assert pilot.vehicle.cockpit.params["FS_GCS_ENABLE"] == 5


def test_a_ping_is_answered() -> None:
    pilot = Pilot("px4")
    pilot.say(dialect.MAVLink_ping_message(77, 5, 0, 0))
    pong = pilot.last("PING")
    assert (pong.time_usec, pong.seq, pong.target_system, pong.target_component) == (77, 5, 255, 190)


@FLAVOURS
def test_another_vehicles_commands_are_not_answered(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.say(command_long(ARM, 1.0, system=2))
    pilot.wait(1.0)
    assert pilot.since(0.0, "COMMAND_ACK") == []
    assert not pilot.armed


def test_what_it_heard_is_on_record() -> None:
    pilot = Pilot("ardupilot")
    pilot.wait(0.5)
    pilot.command(SET_MODE, 1, 4)
    heard = [entry for entry in pilot.protocol.received if entry.name == "COMMAND_LONG"]
    assert [(entry.stamp_s, entry.fields["command"], entry.fields["param2"]) for entry in heard] == [
        (pilot.now_s, SET_MODE, 4.0)
    ]


def test_dropped_commands_are_neither_heard_nor_acknowledged() -> None:
    pilot = Pilot("ardupilot")
    pilot.faults.drop_next(2)
    assert pilot.command(SET_MODE, 1, 4) == []
    assert pilot.command(SET_MODE, 1, 4) == []
    assert pilot.command(SET_MODE, 1, 4) == [ACCEPTED]


def test_frozen_telemetry_goes_on_with_an_old_stamp() -> None:
    pilot = Pilot("px4")
    pilot.wait(1.0)
    pilot.faults.freeze = True
    frozen_s = pilot.now_s
    pilot.wait(2.0)
    assert len({message.time_boot_ms for message in pilot.since(frozen_s + 0.1, "LOCAL_POSITION_NED")}) == 1
    pilot.faults.clear()
    pilot.wait(0.2)
    last_ms = pilot.last("LOCAL_POSITION_NED").time_boot_ms
    assert pilot.vehicle.boot_ms(pilot.now_s) - last_ms < 60


def test_sequence_numbers_count_on_each_link() -> None:
    pilot = Pilot("px4")
    for unknown_to_the_dialect in (8, 380, 410, 411):
        pilot.command(SET_INTERVAL, unknown_to_the_dialect, -1)
    pilot.heard.clear()
    pilot.wait(3.0)
    numbers = [message.get_seq() for _, message in pilot.heard]
    assert all((later - earlier) % 256 == 1 for earlier, later in itertools.pairwise(numbers))


@FLAVOURS
@settings(max_examples=20, deadline=None)
@given(
    commands=st.lists(
        st.tuples(
            st.sampled_from([20, 21, 22, 115, 176, 178, 246, 400, 511, 512, 1000, 31999]),
            st.lists(NUMBERS, min_size=7, max_size=7),
        ),
        max_size=6,
    ),
    point=st.tuples(st.integers(0, 20), st.integers(0, 0xFFFF), st.lists(NUMBERS, min_size=7, max_size=7)),
    value=NUMBERS,
)
def test_no_number_upsets_it(flavour: str, commands: Any, point: Any, value: float) -> None:
    pilot = Pilot(flavour)
    pilot.take_off(1.0)
    for number, params in commands:
        assert len(pilot.command(number, *params)) <= 2
    frame, mask, (x, y, z, vx, vy, vz, yaw) = point
    target = set_point((x, y, z), (vx, vy, vz), frame=frame, mask=mask, yaw=yaw)
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"DISARM_DELAY", value, 2))
    pilot.say(dialect.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", value, 9))
    pilot.wait(1.0, target)
    assert all(math.isfinite(number) for number in pilot.ned)
    assert pilot.height_m >= 0.0


@settings(max_examples=50, deadline=None)
@given(chunks=st.lists(st.binary(max_size=60), max_size=5))
def test_garbage_is_passed_over(chunks: list[bytes]) -> None:
    pilot = Pilot("ardupilot")
    for chunk in chunks:
        pilot.protocol.receive(pilot.now_s, HERE, chunk)
    # A half packet may swallow what comes after it, as on a real link: after a packet's length all is well again.
    for _ in range(12):
        pilot.command(SET_MODE, 1, 4)
    assert pilot.command(SET_MODE, 1, 4) == [ACCEPTED]


def raw(number: int, payload: bytes, sequence: int) -> bytes:
    """Frame a payload of any content as a message of one kind."""
    kind = dialect.mavlink_map[number]
    size = struct.calcsize(kind.unpacker.format)
    head = struct.pack("<BBBBBBHB", size, 0, 0, sequence, 255, 190, number & 0xFFFF, number >> 16)
    body = head + payload[:size].ljust(size, b"\0")
    checksum = dialect.x25crc(body)
    checksum.accumulate(bytes([kind.crc_extra]))
    return b"\xfd" + body + struct.pack("<H", checksum.crc)


EVERYTHING_HEARD = (0, 4, 11, 20, 21, 23, 43, 48, 66, 75, 76, 84, 102, 110, 111, 256, 331)


@FLAVOURS
@settings(max_examples=40, deadline=None)
@given(
    packets=st.lists(st.tuples(st.sampled_from(EVERYTHING_HEARD), st.binary(min_size=1, max_size=255)), max_size=12),
    for_us=st.booleans(),
)
def test_messages_of_any_content_upset_nothing(flavour: str, packets: list[tuple[int, bytes]], for_us: bool) -> None:
    vision = {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "MNT1_TYPE": 1} if flavour == "ardupilot" else {"MNT_MODE_IN": 4}
    pilot = Pilot(flavour, params=vision)
    for number in (32, 33, 242, 285):
        pilot.command(SET_INTERVAL, number, 1e5)
    for sequence, (number, payload) in enumerate(packets):
        addressed = payload.replace(payload[:1], b"\x01") if for_us else payload
        pilot.protocol.receive(pilot.now_s, HERE, raw(number, addressed, sequence))
    pilot.beats = False
    pilot.wait(2.0)
    assert all(math.isfinite(number) for number in pilot.ned)


@pytest.mark.parametrize(
    "trouble", ["jump 1e", "jump 9999999999", "clock 99999999999", "clock -99999999999", "wind -99"]
)
def test_troubles_beyond_measure_upset_nothing(trouble: str) -> None:
    pilot = Pilot("px4")
    if trouble.endswith("e"):
        with pytest.raises(InputError, match="a number is written like"):
            pilot.happen(trouble)
        return
    pilot.happen(trouble)
    pilot.wait(1.0)
    assert pilot.since(START_S + 0.5, "HEARTBEAT")


@FLAVOURS
def test_another_components_commands_are_not_answered(flavour: str) -> None:
    pilot = Pilot(flavour)
    command = command_long(ARM, 1.0)
    command.target_component = 2
    pilot.say(command)
    assert pilot.since(0.0, "COMMAND_ACK") == []
    command.target_component = 0
    pilot.say(command)
    assert pilot.since(0.0, "COMMAND_ACK")


def test_seventeen_strangers_are_not_all_remembered() -> None:
    pilot = Pilot("ardupilot")
    for port in range(40):
        pilot.say(command_long(LAND), address=("stranger", port))
    assert pilot.protocol.listeners(pilot.now_s) == 16


@pytest.mark.parametrize(
    "wrong", [{"flavour": "betaflight"}, {"target": "nowhere"}, {"max_speed_m_s": 0}, {"hover_m": 1}, {"system": 0}]
)
def test_wrong_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        MavlinkDroneSettings.model_validate(wrong)
