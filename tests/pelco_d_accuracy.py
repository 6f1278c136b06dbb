"""How well a head's pose at a frame's stamp is known: random moves of the real driver on an emulated head.

Every move has one frame, at a random moment from its command until some time after it ended; it is judged as the
pipeline would, as soon as both axes have a reading after it.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from camrig.geometry.arrays import Array
from camrig.locate import HeadHistory
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads

SPEEDS = {1: SPEED_DEG_S / 63.0, 63: SPEED_DEG_S}
PLAY_DEG = 0.2
STOP_ERROR_DEG = 0.05
DRIFT = 0.02
JITTER_S = 0.06
ZERO_ERROR_DEG = 0.3
_BOTH = ("pan", "tilt")
_SET_PRESET_1 = bytes.fromhex("ff010003000105")


@dataclass(frozen=True, eq=False)
class Frames:
    """Errors and claimed sigmas, (n, 2) radians each, of pan and tilt, and whether the head truly moved, (n,)."""

    errors_rad: Array
    sigmas_rad: Array
    moving: Array
    unknown: int = 0
    """How many frames more had no pose."""

    @property
    def within_3_sigma(self) -> float:
        """Return the share of angles within three claimed sigmas."""
        return float((np.abs(self.errors_rad) <= 3.0 * self.sigmas_rad).mean())

    @property
    def nees(self) -> float:
        """Return the average normalized estimation error squared; 2 is honest."""
        return float(((self.errors_rad / self.sigmas_rad) ** 2).sum(axis=1).mean())

    @property
    def nees_interval(self) -> tuple[float, float]:
        """Return where 95 % of all averages of so many honest frames lie."""
        count = len(self.errors_rad)
        return float(chi2.ppf(0.025, 2 * count)) / count, float(chi2.ppf(0.975, 2 * count)) / count

    def of(self, moving: bool) -> Frames:
        """Return the frames of a moving or of a resting head alone."""
        chosen = self.moving == moving
        return Frames(self.errors_rad[chosen], self.sigmas_rad[chosen], self.moving[chosen])

    def p95_deg(self) -> float:
        return math.degrees(float(np.percentile(np.abs(self.errors_rad), 95)))


def rig_of(grade: str, baud: int, seed: int, **settings: Any) -> SimulatedHeads:
    """Return an enabled head of a grade, whose section says of it what is true of the emulated one."""
    axis: dict[str, Any] = {"speeds": SPEEDS, "backlash_deg": PLAY_DEG}
    keys: dict[str, Any] = {"grade": grade, "readback_sigma_deg": 0.0}
    usual: Mapping[str, Any] = {"backlash_deg": PLAY_DEG, "stop_error_deg": STOP_ERROR_DEG}
    if grade == "open_loop":
        axis = {"speeds": SPEEDS}
        keys["open_loop"] = {
            "zero": {
                "by": "preset", "preset": 1, "pan_deg": 0.0, "tilt_deg": -30.0,
                "travel_s": 8.0, "sigma_deg": ZERO_ERROR_DEG / math.sqrt(3.0),
            },
            "start_s": 0.05 + 0.5 * JITTER_S, "start_sigma_s": JITTER_S / math.sqrt(12.0), "stop_sigma_s": 0.0,
            "speed_sigma": DRIFT, "rezero_above_deg": 0.2,
        }  # fmt: skip
        usual = {
            "speed_drift": DRIFT, "start_jitter_s": JITTER_S, "stop_error_deg": ZERO_ERROR_DEG,
            "answers": "none", "start_tilt_deg": -30.0,
        }  # fmt: skip
    keys["axes"] = dict.fromkeys(_BOTH, axis)
    rig = SimulatedHeads(1, baud, keys, seed, **{**usual, **settings})
    rig.line.receive(_SET_PRESET_1, rig.time.now_s(), baud)
    rig.time.sleep_s(1.0)
    rig.head.open()
    rig.head.enable()
    return rig


def random_moves(grade: str, baud: int, count: int, seed: int = 1, **settings: Any) -> Frames:
    """Move ``count`` times and judge one frame of each move."""
    rig, rng, history = rig_of(grade, baud, seed, **settings), random.Random(seed), HeadHistory()
    errors, sigmas, moving, unknown = [], [], [], 0
    for reading in rig.poll(1.0):
        history = history.with_reading(reading)
    for _ in range(count):
        rig.move(rng.uniform(-80.0, 80.0), rng.uniform(-80.0, 0.0))
        begun_s = rig.time.now_s() + (8.2 if grade == "open_loop" else 0.0)
        stamp_s = begun_s + rng.uniform(0.0, 4.0)
        judged = False
        while rig.time.now_s() < begun_s + 4.5:
            for reading in rig.head.read(0.3):
                history = history.with_reading(reading)
                if not judged and history.covers(stamp_s):
                    judged = True
                    state = history.at(stamp_s)
                    assert state is not None
                    true_rad = np.array(rig.line.true_angles_rad("pt1", stamp_s))
                    soon_rad = np.array(rig.line.true_angles_rad("pt1", stamp_s - 0.01))
                    errors.append(state.angles_rad - true_rad)
                    sigmas.append(np.sqrt(np.diag(state.covariance)))
                    moving.append(bool(np.abs(soon_rad - true_rad).max() > 1e-6))
        unknown += not judged
    rig.head.close()
    return Frames(np.array(errors), np.array(sigmas), np.array(moving), unknown)
