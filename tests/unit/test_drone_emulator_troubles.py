"""Scripted troubles of the emulated drone, and its own failsafes against them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from camrig.errors import InputError
from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings
from tests.drone_pilot import ARM, GUIDED, SET_INTERVAL, SET_MODE, START_S, Pilot, command_long, set_point

LAND, RTL = 9, 6
FLAVOURS = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


def flying(flavour: str, **settings: Any) -> Pilot:
    pilot = Pilot(flavour, **settings)
    pilot.take_off()
    return pilot


def stay(pilot: Pilot) -> Any:
    return set_point((0.0, 0.0, -2.0)) if pilot.settings.flavour == "px4" else None


def test_a_script_happens_by_the_clock() -> None:
    pilot = Pilot("px4", script="at 2 reboot; from 5 to 6 freeze  # seconds from the start\nat 7 battery 0.4")
    pilot.wait(1.9)
    assert pilot.vehicle.boots == 1
    pilot.wait(0.2)
    assert pilot.vehicle.boots == 2
    pilot.wait(3.4)
    assert pilot.faults.freeze
    pilot.wait(2.0)
    assert not pilot.faults.freeze
    assert pilot.last("SYS_STATUS").battery_remaining == 40


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("at 5 explode", "'explode' is none of battery"),
        ("at 5 mode SIDEWAYS", "mode needs one of"),
        ("at 5 mode", "mode needs one of"),
        ("from 3 to 2 no_pose", "ends before it begins"),
        ("from 3 to 5 reboot", "'reboot' is none of"),
        ("at 5 wind", "wind needs a number"),
        ("at 5 garble 3", "0 to 1"),
        ("at 5 latency -1", "no number below 0"),
        ("at 5 on d1 reboot", "leave out 'on d1'"),
        ("reboot", "write 'at SECONDS FAULT'"),
        ("at 5 echo", "'echo' is none of"),
    ],
)
def test_a_wrong_script_is_refused_in_one_sentence(script: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        MavlinkDrone(MavlinkDroneSettings(script=script))


@FLAVOURS
def test_a_reboot_is_silent_then_noisy_and_forgets(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.command(SET_INTERVAL, 32, 2e4)
    pilot.wait(1.0)
    pilot.happen("reboot")
    booted_s = pilot.now_s
    pilot.wait(3.0)
    stamps = [stamp_s for stamp_s, _ in pilot.heard if stamp_s > booted_s + 0.03]
    assert min(stamps) - booted_s == pytest.approx(1.2, abs=0.1)
    assert pilot.since(booted_s, "BAD_DATA")
    assert pilot.since(booted_s + 0.03, "HEARTBEAT")
    places = pilot.since(booted_s + 0.03, "LOCAL_POSITION_NED")
    assert len(places) == (0 if flavour == "ardupilot" else pytest.approx(54, abs=4))


@FLAVOURS
def test_the_estimate_jumps_and_the_drone_with_it(flavour: str) -> None:
    pilot = flying(flavour)
    pilot.happen("jump 0.8")
    pilot.wait(0.15, stay(pilot))
    assert pilot.last("LOCAL_POSITION_NED").y == pytest.approx(0.8, abs=0.1)
    assert pilot.ned[1] == pytest.approx(0.0, abs=0.1)
    pilot.wait(3.0, stay(pilot))
    assert pilot.ned[1] == pytest.approx(-0.8, abs=0.1)
    pilot.happen("jump_up -0.5")
    pilot.wait(3.0, stay(pilot))
    assert pilot.height_m == pytest.approx(2.5, abs=0.1)


@FLAVOURS
def test_wind_pushes_and_leans_it(flavour: str) -> None:
    pilot = flying(flavour)
    pilot.happen("wind 5")
    pilot.wait(4.0, stay(pilot))
    pushed_m = pilot.ned[1]
    assert 0.05 < pushed_m < 0.5
    pilot.happen("clear")
    pilot.wait(4.0, stay(pilot))
    assert abs(pilot.ned[1]) < 0.05


def test_another_ground_station_changes_the_mode() -> None:
    pilot = flying("ardupilot")
    pilot.happen("mode LAND")
    pilot.wait(0.1)
    assert pilot.mode == LAND
    pilot = flying("px4")
    pilot.happen("mode hold")
    pilot.wait(1.0, stay(pilot))
    assert pilot.mode == 0x03040000


@FLAVOURS
def test_the_boot_clock_jumps(flavour: str) -> None:
    pilot = Pilot(flavour)
    pilot.command(SET_INTERVAL, 32, 2e4)
    pilot.wait(0.5)
    before_ms = pilot.last("LOCAL_POSITION_NED").time_boot_ms
    pilot.happen("clock -10")
    pilot.wait(0.5)
    assert pilot.last("LOCAL_POSITION_NED").time_boot_ms == pytest.approx(before_ms - 9500, abs=100)


def test_speeds_are_acknowledged_and_forgotten() -> None:
    pilot = flying("ardupilot")
    pilot.happen("ignore_speed")
    assert pilot.command(178, 1, 0.4) == [0]
    pilot.say(set_point((6.0, 0.0, -2.0)))
    pilot.wait(2.5)
    assert pilot.speed_m_s > 1.5


def test_the_estimator_fails_at_once() -> None:
    pilot = flying("ardupilot")
    pilot.happen("ekf_failure")
    pilot.wait(0.3)
    assert pilot.mode == LAND
    pilot = flying("px4")
    pilot.happen("ekf_failure")
    pilot.wait(1.0, stay(pilot))
    assert pilot.mode == 0x00020000


@pytest.mark.parametrize(
    ("flavour", "params", "level", "text", "mode"),
    [
        ("ardupilot", {"BATT_LOW_MAH": 1000.0, "BATT_FS_LOW_ACT": 1}, 0.25, "Battery 1 is low 14.70V", LAND),
        ("ardupilot", {"BATT_LOW_MAH": 1000.0}, 0.25, "Battery 1 is low 14.70V", GUIDED),
        ("px4", {"COM_LOW_BAT_ACT": 2}, 0.05, "Critical battery level\t", 0x06040000),
        ("px4", {}, 0.05, "Critical battery level\t", 0x00060000),
    ],
)
def test_a_low_battery(flavour: str, params: dict[str, float], level: float, text: str, mode: int) -> None:
    pilot = flying(flavour, params=params)
    pilot.happen(f"battery {level}")
    pilot.wait(1.5, stay(pilot))
    assert text in [said for _, said in pilot.texts()]
    assert pilot.mode == mode
    assert pilot.last("SYS_STATUS").battery_remaining == round(100 * level)


@pytest.mark.parametrize(
    ("flavour", "params", "target", "mode"),
    [
        ("ardupilot", {"FENCE_ENABLE": 1, "FENCE_RADIUS": 1.5, "FENCE_ACTION": 2}, (3.0, 0.0, -2.0), LAND),
        ("ardupilot", {"FENCE_ENABLE": 1, "FENCE_ALT_MAX": 3.0, "FENCE_ACTION": 0}, (0.0, 0.0, -4.0), GUIDED),
        ("px4", {"GF_MAX_HOR_DIST": 1.5}, (3.0, 0.0, -2.0), 0x03040000),
        ("px4", {"GF_MAX_VER_DIST": 3.0, "GF_ACTION": 5}, (0.0, 0.0, -4.0), 0x06040000),
    ],
)
def test_a_fence(flavour: str, params: dict[str, float], target: tuple[float, float, float], mode: int) -> None:
    pilot = flying(flavour, params=params)
    assert pilot.last("SYS_STATUS").onboard_control_sensors_health & 0x100000
    left_s = pilot.now_s
    pilot.wait(2.0, set_point(target))
    healths = [status.onboard_control_sensors_health & 0x100000 for status in pilot.since(left_s, "SYS_STATUS")]
    assert 0 in healths
    pilot.wait(2.0, set_point(target))
    assert pilot.mode == mode
    assert any("fence" in text.lower() for _, text in pilot.texts())


def test_noise_comes_before_the_next_message() -> None:
    pilot = Pilot("ardupilot")
    pilot.happen("noise 40")
    pilot.wait(3.0)
    assert pilot.since(0.0, "BAD_DATA")
    assert pilot.since(0.0, "HEARTBEAT")


def test_a_repeated_command_is_the_same_command() -> None:
    """MAVSDK says a command three times more when nobody acknowledges; the take-off goes on."""
    for flavour in ("ardupilot", "px4"):
        pilot = Pilot(flavour)
        if flavour == "ardupilot":
            pilot.command(SET_MODE, 1, GUIDED)
        pilot.command(ARM, 1)
        take_off = command_long(22, 0, 0, 0, np.nan, 0, 0, np.nan if flavour == "px4" else 2.0)
        for confirmation in range(4):
            take_off.confirmation = confirmation
            pilot.say(take_off)
            pilot.wait(0.5)
        pilot.wait(4.0)
        assert pilot.height_m == pytest.approx(2.0 if flavour == "ardupilot" else 2.5, abs=0.15)
    assert pilot.now_s > START_S
