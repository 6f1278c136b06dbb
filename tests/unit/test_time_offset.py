"""The time between a camera's stamps and its head's reports, learnt from anchors while the head moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.locate import Histories, camera_pose, locate, with_offset
from camrig.locate.time_offset import PRIOR_S, TimeOffset
from camrig.messages import AxisReading
from tests.anchored_cameras import HEAD_CAMERA, KINEMATICS, ON_FLOOR, PAN, RIG, T_MOUNT, TILT, seen

REPORTS_HZ, FRAMES_HZ = 10.0, 10.0
SWING_RAD, PERIOD_S = 0.25, 4.0
REPORT_RAD = 0.0005
"""The noise of one report."""


def swinging(stamp_s: float, swing_rad: float) -> tuple[float, float]:
    phase = math.tau * stamp_s / PERIOD_S
    return PAN + swing_rad * math.sin(phase), TILT + 0.3 * swing_rad * math.cos(0.7 * phase)


def learnt(
    late_s: float,
    seconds: float,
    seed: int,
    swing_rad: float = SWING_RAD,
    bias_rad: float = 0.002,
    noise_rad: float = REPORT_RAD,
) -> tuple[Histories, float]:
    """Return what was learnt of a head whose reports come from ``late_s`` before their stamps, and when."""
    rng, histories = np.random.default_rng(seed), Histories()
    stamp_s = 0.0
    for k in range(int(seconds * REPORTS_HZ)):
        told_s = k / REPORTS_HZ
        pan_rad, tilt_rad = swinging(told_s - late_s, swing_rad) + rng.normal(bias_rad, noise_rad, 2)
        histories = histories.with_reading(AxisReading("h", "pan", pan_rad, told_s, noise_rad, 0.0))
        histories = histories.with_reading(AxisReading("h", "tilt", tilt_rad, told_s, noise_rad, 0.0))
        stamp_s = told_s - 0.3 + rng.uniform(0.0, 0.1)
        T = KINEMATICS.T_world_camera(*swinging(stamp_s, swing_rad), T_MOUNT)
        shown = locate(seen(ON_FLOOR[:2], T, HEAD_CAMERA, rng, stamp_s), histories, RIG, {}).head_angles
        histories = with_offset(histories, HEAD_CAMERA, shown)
    return histories, stamp_s


@pytest.mark.parametrize("late_s", [-0.03, 0.0, 0.012, 0.08])
def test_the_offset_of_a_moving_head_is_found_within_its_sigma(late_s: float) -> None:
    errors = []
    for seed in range(3):
        offset = learnt(late_s, 20.0, seed)[0].offset("north")
        assert offset.sigma_s < 0.0015
        errors.append((offset.offset_s - late_s) / offset.sigma_s)
        assert abs(offset.offset_s - late_s) < 0.002
    assert np.abs(errors).max() < 4.0


@pytest.mark.parametrize("late_s", [0.15, 0.24])
def test_a_great_offset_is_never_thought_better_known_than_it_is(late_s: float) -> None:
    for seconds in (10.0, 20.0, 40.0):
        offset = learnt(late_s, seconds, 1)[0].offset("north")
        assert abs(offset.offset_s - late_s) < 6.0 * offset.sigma_s
    assert abs(offset.offset_s - late_s) < 0.01


@pytest.mark.parametrize("lost_rad", [0.09, -0.17])
def test_a_zero_that_is_lost_is_no_offset(lost_rad: float) -> None:
    for seconds in (5.0, 15.0, 30.0):
        offset = learnt(0.0, seconds, 2, bias_rad=lost_rad)[0].offset("north")
        assert abs(offset.offset_s) < 4.0 * offset.sigma_s


def test_the_noise_of_a_resting_heads_reports_is_no_motion() -> None:
    offset = learnt(0.05, 30.0, 1, swing_rad=0.0, noise_rad=0.004)[0].offset("north")
    assert abs(offset.offset_s) < 0.0005


def test_a_resting_head_tells_nothing_of_it_whatever_its_bias() -> None:
    offset = learnt(0.05, 20.0, 1, swing_rad=0.0, bias_rad=0.004)[0].offset("north")
    assert abs(offset.offset_s) < 0.0005
    assert offset.sigma_s > 0.9 * PRIOR_S


def test_the_camera_is_then_where_its_picture_was_taken() -> None:
    """Without an anchor in view: 80 ms are nearly two degrees at full speed."""
    histories, _ = learnt(0.08, 20.0, 2, bias_rad=0.0)
    assert worst_rad(Histories(histories.heads)) > math.radians(1.5)
    assert worst_rad(histories) < math.radians(0.25)


def worst_rad(histories: Histories) -> float:
    """By how much a camera is thought to look elsewhere than it does, at worst in two seconds."""
    worst = 0.0
    for stamp_s in np.linspace(17.5, 19.5, 40):
        truth = KINEMATICS.T_world_camera(*swinging(float(stamp_s), SWING_RAD), T_MOUNT)
        found = camera_pose(HEAD_CAMERA, RIG, histories, float(stamp_s))
        assert found is not None
        worst = max(worst, float(np.linalg.norm(pose.difference(truth, found.T_world_camera)[3:])))
    return worst


def test_frames_that_come_late_change_nothing() -> None:
    histories, stamp_s = learnt(0.02, 10.0, 3)
    T = KINEMATICS.T_world_camera(*swinging(stamp_s - 1.0, SWING_RAD), T_MOUNT)
    shown = locate(seen(ON_FLOOR[:2], T, HEAD_CAMERA, None, stamp_s - 1.0), histories, RIG, {}).head_angles
    before, after = (told.offset("north") for told in (histories, with_offset(histories, HEAD_CAMERA, shown)))
    assert isinstance(before, TimeOffset)
    assert after is before
