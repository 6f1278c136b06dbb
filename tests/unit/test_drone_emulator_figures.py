"""With ``figures: measured`` the emulated drone is as quick and as unsteady as the real autopilots were seen to be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from camrig_emulators.mavlink.settings import MavlinkDroneSettings
from tests.drone_pilot import ARM, GUIDED, LAND, SET_INTERVAL, SET_MODE, TAKE_OFF, Pilot, set_point

EAST_RAD = math.pi / 2.0


@dataclass
class Range:
    """What was measured, widened by a tenth of a second or by the spread of our noise."""

    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


FIGURES = {
    "ardupilot": {
        "up_s": Range(3.4, 5.8),
        "step_s": Range(1.8, 2.4),
        "hold_mean_m": Range(0.015, 0.045),
        "hold_max_m": Range(0.02, 0.11),
        "turn_s": Range(1.5, 2.0),
        "land_s": Range(4.0, 4.8),
        "disarm_s": Range(1.7, 2.3),
    },
    "px4": {
        "up_s": Range(4.5, 6.2),
        "step_s": Range(1.6, 3.2),
        "hold_mean_m": Range(0.15, 0.32),
        "hold_max_m": Range(0.25, 0.56),
        "turn_s": Range(0.8, 1.2),
        "land_s": Range(5.0, 9.0),
        "disarm_s": Range(1.7, 3.0),
    },
}


class Flight:
    """The flight that was measured: 2 m up, 1 m north, hold for 8 s, turn by 90 degrees, land."""

    def __init__(self, flavour: str) -> None:
        self.pilot = Pilot(flavour, figures="measured", seed=0)
        self.pilot.quiet()
        self.pilot.command(SET_INTERVAL, 32, 4e4)
        self.pilot.until(lambda: self.pilot.vehicle.cockpit.ready)
        self.pilot.wait(0.5)
        self.start_ned = self.place() if flavour == "px4" else np.zeros(3)  # PX4's wanders: aim relative to it

    def place(self) -> Any:
        message = self.pilot.last("LOCAL_POSITION_NED")
        return np.array([message.x, message.y, message.z])

    def point(self, north_m: float, yaw_rad: float = EAST_RAD) -> Any:
        return set_point(tuple(self.start_ned + np.array([north_m, 0.0, -2.0])), yaw=yaw_rad)

    def off_m(self, north_m: float) -> float:
        return float(np.linalg.norm(self.place() - self.start_ned - [north_m, 0.0, -2.0]))

    def take_off(self) -> float:
        pilot, here = self.pilot, self.point(0.0)
        if pilot.settings.flavour == "ardupilot":
            pilot.command(SET_MODE, 1, GUIDED)
            pilot.command(ARM, 1)
            pilot.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 2.0)
            took_s = pilot.until(lambda: pilot.height_m > 1.9)
            pilot.until(lambda: self.off_m(0.0) < 0.1)
            return took_s
        pilot.wait(0.5, here)
        pilot.command(SET_MODE, 1, 6)
        pilot.until(lambda: pilot.mode == 6 << 16, here)
        pilot.command(ARM, 1)
        return pilot.until(lambda: pilot.height_m > 1.9, here)

    def fly(self) -> dict[str, float]:
        pilot, there = self.pilot, self.point(1.0)
        near_m = 0.3 if pilot.settings.flavour == "px4" else 0.1
        up_s = self.take_off()
        pilot.wait(2.0, self.point(0.0))
        step_s = pilot.until(lambda: self.off_m(1.0) < near_m, there)
        pilot.wait(2.0, there)
        errors_m = []
        for _ in range(80):
            pilot.wait(0.1, there)
            errors_m.append(self.off_m(1.0))
        south = self.point(1.0, math.pi)
        truth = pilot.vehicle.history
        turn_s = pilot.until(
            lambda: abs(math.remainder(truth.latest.truth.yaw_rad + math.pi / 2.0, math.tau)) < 0.05, south
        )
        pilot.command(LAND)
        land_s = pilot.until(lambda: pilot.height_m == 0.0)
        disarm_s = pilot.until(lambda: not pilot.armed)
        mean_m, worst_m = float(np.mean(errors_m)), max(errors_m)
        values = (up_s, step_s, mean_m, worst_m, turn_s, land_s, disarm_s)
        return dict(zip(FIGURES["px4"], values, strict=True))


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_the_measured_flight(flavour: str) -> None:
    flown = Flight(flavour).fly()
    assert {name: value for name, value in flown.items() if value not in FIGURES[flavour][name]} == {}


def test_what_is_given_stays_as_it_is_given() -> None:
    settings = MavlinkDroneSettings.model_validate({"flavour": "px4", "figures": "measured", "hover_noise_m": 0.0})
    assert settings.hover_noise_m == 0.0
    assert settings.ready_after_s == 3.0
    assert MavlinkDroneSettings(flavour="px4").ready_after_s == 0.0


def test_ardupilot_takes_eleven_seconds_to_be_ready() -> None:
    pilot = Pilot("ardupilot", figures="measured")
    assert pilot.until(lambda: pilot.vehicle.cockpit.ready) == pytest.approx(11.0, abs=0.2)
    pilot.command(246, 1)  # and again after each boot
    pilot.wait(2.0)
    assert not pilot.vehicle.cockpit.ready
