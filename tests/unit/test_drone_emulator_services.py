"""The emulated drone beside flying: signing, gimbal, releases, streams that no dialect knows, files, missions."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.errors import InputError
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.protocol import MavlinkProtocol
from camrig_emulators.mavlink.settings import MavlinkDroneSettings
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.mavlink_drone import MavlinkDrone
from tests.drone_pilot import (
    ACCEPTED,
    ARM,
    FAILED,
    GUIDED,
    HERE,
    REQUEST,
    SET_INTERVAL,
    SET_MODE,
    START_S,
    Pilot,
    command_long,
    set_point,
)

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
CONFIGURE, PITCH_YAW, MOUNT_CONTROL = 1001, 1000, 205
DENIED = 2
FLAVOURS = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


def setup_signing(key: bytes, timestamp: int) -> Any:
    return dialect.MAVLink_setup_signing_message(1, 1, list(key), timestamp)


class Signer:
    """One end of a link, with a key or without."""

    def __init__(
        self, protocol: MavlinkProtocol, key: bytes | None = None, *, link: int = 7, lenient: bool = False
    ) -> None:
        self._protocol = protocol
        self._mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self._mav.signing.link_id = link
        self._mav.signing.allow_unsigned_callback = lambda _mav, _number: lenient
        if key is not None:
            self._mav.signing.secret_key = key
            self._mav.signing.sign_outgoing = True
            self._mav.signing.timestamp = 20_000_000

    def ask(self, message: Any, now_s: float = START_S + 0.1) -> list[Any]:
        """Send a message and return what comes back."""
        data = bytes(message.pack(self._mav))
        heard = b"".join(answer for _, answer in self._protocol.receive(now_s, HERE, data))
        return list(self._mav.parse_buffer(heard) or ())

    def acknowledged(self, now_s: float) -> bool:
        return any(m.get_type() == "COMMAND_ACK" for m in self.ask(command_long(REQUEST, 148), now_s))


def two_links(flavour: str) -> tuple[MavlinkProtocol, MavlinkProtocol]:
    """Return channel 0 and channel 1 of one vehicle."""
    vehicle = Vehicle(MavlinkDroneSettings.model_validate({"flavour": flavour}), START_S, 0)
    first, second = (MavlinkProtocol(vehicle, Faults(), 0, channel=channel) for channel in (0, 1))
    return first, second


def test_ardupilot_asks_for_signatures_everywhere_but_on_channel_0() -> None:
    usb, radio = two_links("ardupilot")
    answers = Signer(usb).ask(setup_signing(KEY, 20_000_000))
    assert "COMMAND_ACK" not in [answer.get_type() for answer in answers]
    assert not Signer(radio).acknowledged(START_S + 1.0)
    assert not Signer(radio, OTHER_KEY, link=8).acknowledged(START_S + 1.1)
    signer = Signer(radio, KEY)
    answers = signer.ask(command_long(REQUEST, 148), START_S + 1.2)
    assert "COMMAND_ACK" in [answer.get_type() for answer in answers]
    assert all(answer.get_signed() for answer in answers)
    assert Signer(usb).acknowledged(START_S + 1.3)
    unsigned = Signer(usb).ask(command_long(REQUEST, 148), START_S + 1.4)
    assert unsigned
    assert not any(answer.get_signed() for answer in unsigned)


def test_a_replayed_packet_is_not_heard() -> None:
    _, radio = two_links("ardupilot")
    Signer(radio).ask(setup_signing(KEY, 20_000_000))
    signer = Signer(radio, KEY)
    assert signer.acknowledged(START_S + 1.0)
    signer._mav.signing.timestamp = 20_000_000  # a clock that was set back
    assert not signer.acknowledged(START_S + 1.1)


def test_signing_outlives_a_reboot_and_ends_with_a_zero_key() -> None:
    usb, radio = two_links("ardupilot")
    Signer(usb).ask(setup_signing(KEY, 20_000_000))
    usb.vehicle.advance_to(START_S + 1.0)
    usb.vehicle.reboot()
    assert not Signer(radio).acknowledged(START_S + 3.0)
    Signer(usb).ask(setup_signing(bytes(32), 0), START_S + 3.1)
    assert Signer(radio).acknowledged(START_S + 3.2)


def test_px4_has_no_signing() -> None:
    usb, radio = two_links("px4")
    Signer(usb).ask(setup_signing(KEY, 20_000_000))
    assert Signer(radio).acknowledged(START_S + 1.0)
    assert Signer(radio, KEY, lenient=True).acknowledged(START_S + 1.1)


def pitch_yaw_deg(pilot: Pilot) -> tuple[float, float]:
    w, x, y, z = pilot.last("GIMBAL_DEVICE_ATTITUDE_STATUS").q
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return math.degrees(pitch), math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def test_ardupilots_servo_mount_points_where_it_is_told() -> None:
    pilot = Pilot("ardupilot", params={"MNT1_TYPE": 1})
    pilot.command(SET_INTERVAL, 285, 1e5)
    assert pilot.command(PITCH_YAW, -45.0, 30.0, math.nan, math.nan, 0, 0, 0) == [ACCEPTED]
    pilot.wait(2.0)
    assert pitch_yaw_deg(pilot) == pytest.approx((-45.0, 30.0), abs=0.01)
    assert pilot.command(PITCH_YAW, -120.0, math.nan, math.nan, math.nan, 16) == [ACCEPTED]
    pilot.wait(2.0)
    assert pitch_yaw_deg(pilot)[0] == pytest.approx(-90.0, abs=0.1)
    assert pilot.last("GIMBAL_DEVICE_ATTITUDE_STATUS").flags & 16
    assert pilot.command(MOUNT_CONTROL, -30.0, 0, 0, 0, 0, 0, 2) == [ACCEPTED]
    pilot.wait(2.0)
    assert pitch_yaw_deg(pilot)[0] == pytest.approx(-30.0, abs=0.01)
    assert pilot.command(CONFIGURE, 255, 190, -1, -1, 0, 0, 0) == [ACCEPTED]
    assert pilot.command(REQUEST, 280) == [ACCEPTED]
    limits = pilot.last("GIMBAL_MANAGER_INFORMATION")
    assert (limits.pitch_min, limits.pitch_max) == pytest.approx((math.radians(-90.0), math.radians(20.0)))


def test_px4s_gimbal_wants_to_be_taken_control_of() -> None:
    pilot = Pilot("px4", params={"MNT_MODE_IN": 4, "MNT_MODE_OUT": 2})
    assert pilot.command(PITCH_YAW, -45.0, 0.0) == [DENIED]
    assert pilot.command(CONFIGURE, 255, 190, -1, -1) == [ACCEPTED]
    assert pilot.command(PITCH_YAW, -45.0, 0.0) == [ACCEPTED]
    pilot.command(REQUEST, 281)
    assert pilot.last("GIMBAL_MANAGER_STATUS").primary_control_sysid == 255


def test_without_a_mount_there_is_nothing_to_tell() -> None:
    pilot = Pilot("ardupilot")
    assert pilot.command(CONFIGURE, 255, 190) == [FAILED]
    assert pilot.command(MOUNT_CONTROL, -30.0, 0, 0, 0, 0, 0, 2) == [FAILED]
    assert pilot.command(REQUEST, 280) == [FAILED]


@pytest.mark.parametrize(
    ("release", "names", "version"),
    [
        ("4.5", {"SYSID_THISMAV", "SYSID_MYGCS", "GPS_TYPE"}, 0x0405),
        ("4.6", {"SYSID_THISMAV", "SYSID_MYGCS", "GPS1_TYPE"}, 0x0406),
        ("4.7", {"MAV_SYSID", "MAV_GCS_SYSID", "GPS1_TYPE"}, 0x0407),
    ],
)
def test_names_of_parameters_move_from_release_to_release(release: str, names: set[str], version: int) -> None:
    pilot = Pilot("ardupilot", release=release, system=255)
    pilot.say(dialect.MAVLink_param_request_list_message(1, 1))
    told = {value.param_id for value in pilot.since(0.0, "PARAM_VALUE")}
    moved = {"SYSID_THISMAV", "SYSID_MYGCS", "GPS_TYPE", "GPS1_TYPE", "MAV_SYSID", "MAV_GCS_SYSID"}
    assert told & moved == names
    pilot.command(REQUEST, 148)
    assert pilot.last("AUTOPILOT_VERSION").flight_sw_version >> 16 == version
    own = "MAV_GCS_SYSID" if release == "4.7" else "SYSID_MYGCS"
    strict = Pilot("ardupilot", release=release, system=245, params={own: 245, "FS_GCS_ENABLE": 5})
    strict.wait(7.0)
    assert strict.command(ARM, 1) == [ACCEPTED]  # its heartbeats count


@pytest.mark.parametrize(
    "wrong",
    [
        {"release": "4.4"},
        {"target": "tcp://nowhere"},
        {"flavour": "px4", "release": "4.7"},
        {"params": {"EKF2_EV_CTRL": 1}},
        {"release": "4.5", "params": {"MAV_SYSID": 1}},
        {"transport": "tcp", "target": "127.0.0.1:1"},
        {"transport": "serial", "port": 5760},
    ],
)
def test_settings_that_do_not_fit_together_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"release|parameter|target|serial"):
        MavlinkDroneSettings.model_validate(wrong)


def test_px4_pushes_what_no_dialect_knows_and_ardupilot_does_not_speak_it() -> None:
    pilot = Pilot("px4")
    pilot.wait(5.5)
    names = {message.get_type() for _, message in pilot.heard}
    assert {"UNKNOWN_8", "UNKNOWN_380", "UNKNOWN_410", "UNKNOWN_411", "ODOMETRY", "ESTIMATOR_STATUS"} <= names
    assert len(pilot.since(0.0, "ODOMETRY")) == pytest.approx(165, abs=5)
    assert pilot.command(SET_INTERVAL, 411, -1) == [ACCEPTED]
    assert Pilot("ardupilot").command(SET_INTERVAL, 331, 1e5) == [FAILED]


def test_more_can_be_pushed_unasked() -> None:
    pilot = Pilot("ardupilot", streams_hz={1: 2.0})
    pilot.wait(4.0)
    assert len(pilot.since(0.0, "SYS_STATUS")) == pytest.approx(8, abs=1)
    with pytest.raises(InputError, match="ardupilot is emulated without message 331, 999"):
        MavlinkDrone(MavlinkDroneSettings(streams_hz={999: 1.0, 331: 1.0, 1: 1.0}))


@FLAVOURS
def test_every_message_can_be_told(flavour: str) -> None:
    pilot = Pilot(flavour, params={"MNT1_TYPE": 1} if flavour == "ardupilot" else {"MNT_MODE_IN": 4})
    spoken = {"ardupilot": (1, 2, 24, 30, 31, 32, 33, 49, 74, 85, 147, 148, 162, 193, 241, 242, 245, 280, 281, 285)}
    for number in spoken.get(flavour, (2, 8, 74, 83, 85, 105, 141, 230, 241, 280, 331, 380, 410, 411)):
        assert pilot.command(REQUEST, number) == [ACCEPTED], number
    assert not any(message.get_type() == "BAD_DATA" for _, message in pilot.heard)


@FLAVOURS
def test_the_interval_of_a_message_can_be_asked_for(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.command(SET_INTERVAL, 32, 50_000)
    assert pilot.command(510, 32) == [ACCEPTED]
    assert (pilot.last("MESSAGE_INTERVAL").message_id, pilot.last("MESSAGE_INTERVAL").interval_us) == (32, 50_000)
    pilot.command(SET_INTERVAL, 32, -1)
    pilot.command(510, 32)
    assert pilot.last("MESSAGE_INTERVAL").interval_us == -1


@pytest.mark.parametrize(("opcode", "answer", "reason"), [(4, 129, 10), (15, 129, 7), (2, 128, 0)])
def test_files_are_refused_so_that_nobody_waits(opcode: int, answer: int, reason: int) -> None:
    pilot = Pilot("ardupilot")
    payload = bytearray(251)
    payload[0:2], payload[2], payload[3] = (7).to_bytes(2, "little"), 1, opcode
    pilot.say(dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    told = bytes(pilot.last("FILE_TRANSFER_PROTOCOL").payload)
    assert (int.from_bytes(told[:2], "little"), told[3], told[5], told[12]) == (8, answer, opcode, reason)


def test_there_is_no_mission() -> None:
    pilot = Pilot("px4")
    pilot.say(dialect.MAVLink_mission_request_list_message(1, 1, 1))
    assert (pilot.last("MISSION_COUNT").count, pilot.last("MISSION_COUNT").mission_type) == (0, 1)


def test_an_acceleration_is_flown_until_the_guided_timeout() -> None:
    pilot = Pilot("ardupilot")
    pilot.take_off()
    push = set_point(mask=0xC3F)
    push.afx = 0.5
    pilot.wait(2.0, push)
    assert pilot.speed_m_s == pytest.approx(1.0, abs=0.2)
    pilot.wait(5.0)
    assert pilot.speed_m_s < 0.1
    pilot.say(set_point((5.0, 0.0, -2.0), mask=0xC38))  # position with acceleration: nobody flies that
    pilot.wait(2.0)
    assert pilot.speed_m_s < 0.1


def test_condition_yaw_turns_at_its_own_rate() -> None:
    pilot = Pilot("ardupilot", start_yaw_deg=90.0)
    pilot.take_off()
    assert pilot.command(115, 90.0, 30.0, 1, 0) == [ACCEPTED]
    took_s = pilot.until(lambda: abs(pilot.vehicle.history.latest.truth.yaw_rad) < 0.05)
    assert took_s == pytest.approx(3.2, abs=0.4)


def test_ardupilot_takes_guided_without_gps_and_sinks() -> None:
    pilot = Pilot("ardupilot")
    pilot.take_off()
    assert pilot.command(SET_MODE, 1, 20) == [ACCEPTED]
    pilot.until(lambda: pilot.height_m == 0.0)


def test_the_old_set_mode_is_obeyed_without_a_word() -> None:
    pilot = Pilot("ardupilot")
    count = len(pilot.since(0.0, "COMMAND_ACK"))
    pilot.say(dialect.MAVLink_set_mode_message(1, 1, GUIDED))
    pilot.wait(0.1)
    assert pilot.mode == GUIDED
    assert len(pilot.since(0.0, "COMMAND_ACK")) == count


def test_px4_does_not_arm_where_it_waits_for_a_remote_control() -> None:
    pilot = Pilot("px4", params={"COM_RC_IN_MODE": 0})
    assert pilot.command(ARM, 1) == [1]
    pilot.wait(1.5)
    assert pilot.texts()[-1] == (2, "Arming denied: no manual control input\t")
