"""A head's axes and camera from pictures of tags, alone: what is found, what is named, what is left as it was."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.calibrate.head import HeadCalibration, calibrate_head
from camrig.calibrate.head_aims import safe_range, tour
from camrig.calibrate.head_fit import UNKNOWNS
from camrig.calibrate.head_model import AxisModel, missed_px, views_of
from camrig.calibrate.head_start import Turn, expected_axes, tilt_of, turn, with_turns
from camrig.calibrate.head_timing import Run, axis_timing
from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.geometry.pose import perturb
from tests.head_shots import AIMS_DEG, FILE, ROUGH, SIZES_M, TAGS, TRUE, seen_from
from tests.simulated_room import LENS


@pytest.fixture(scope="module")
def found() -> HeadCalibration:
    return calibrate_head(seen_from(AIMS_DEG), LENS, SIZES_M, ROUGH)


def test_axes_and_camera_are_found_without_an_anchor(found: HeadCalibration) -> None:
    model = found.fit.model
    for axis, true in zip(model.axes, TRUE.axes, strict=True):
        assert axis.factor == pytest.approx(true.factor, abs=2e-3)
        assert axis.play_rad == pytest.approx(true.play_rad, abs=3e-4)
    assert model.axes[1].offset_rad == pytest.approx(TRUE.axes[1].offset_rad, abs=1e-3)
    np.testing.assert_allclose(model.T_arm_tilt, TRUE.T_arm_tilt, atol=2e-3)
    np.testing.assert_allclose(model.T_mount_camera, TRUE.T_mount_camera, atol=2e-3)
    assert (found.anchored, found.unshown, found.loose) == (False, (), ())
    assert found.fit.noise_px == pytest.approx(0.05, rel=0.2)


def test_what_the_motion_did_not_show_stays_and_is_named() -> None:
    level = calibrate_head(seen_from([(pan, -50.0) for pan in range(-80, 81, 10)]), LENS, SIZES_M, ROUGH)
    assert "tilt factor" in level.unshown
    assert level.fit.model.axes[1].factor == ROUGH.axes[1].factor
    # Tilt is a degree off by that, which pan's scale cannot be free of.
    assert level.fit.model.axes[0].factor == pytest.approx(-1.36, rel=0.01)


def test_a_tag_that_moved_half_way_is_named_and_left_out(found: HeadCalibration) -> None:
    aims_deg = AIMS_DEG[::2]
    shots = seen_from(aims_deg)
    name = max(found.fit.views.tags, key=lambda tag: sum(tag in shot.corners_px for shot in shots))
    elsewhere = seen_from(
        aims_deg, tags={**TAGS, name: perturb(TAGS[name], np.array([0.05, 0.02, 0.0, 0.0, 0.0, 0.1]))}
    )
    half = len(shots) // 2
    result = calibrate_head([*shots[:half], *elsewhere[half:]], LENS, SIZES_M, ROUGH)
    assert result.loose == (name,)
    assert result.fit.model.axes[0].factor == pytest.approx(-1.36, abs=2e-3)


def test_a_counting_that_bends_is_followed() -> None:
    bent = replace(TRUE, axes=(replace(TRUE.axes[0], sine_rad=0.01, cosine_rad=-0.004), TRUE.axes[1]))
    axis = calibrate_head(seen_from(AIMS_DEG, bent), LENS, SIZES_M, ROUGH, TAGS).fit.model.axes[0]
    assert axis.sine_rad == pytest.approx(0.01, abs=5e-4)
    assert axis.cosine_rad == pytest.approx(-0.004, abs=5e-4)


def test_too_few_stops_say_what_is_missing() -> None:
    with pytest.raises(InputError, match="only 6 of 6 stops showed a tag, and 8 are needed"):
        calibrate_head(seen_from(AIMS_DEG[12:15]), LENS, SIZES_M, ROUGH)


def test_derivatives_are_those_of_the_pixels() -> None:
    views = views_of(seen_from(AIMS_DEG[10:14]), LENS, SIZES_M)
    tags = np.stack([TAGS[name] for name in views.tags])
    off = np.zeros_like(views.reported_rad)
    before, by_link = missed_px(TRUE, tags, views, off)
    step = 1e-6
    for axis in range(6):
        change = step * np.eye(6)[axis]
        moved = replace(TRUE, T_mount_camera=perturb(TRUE.T_mount_camera, change))
        slope = (missed_px(moved, tags, views, off)[0] - before) / step
        np.testing.assert_allclose(by_link[:, :, 4, axis], slope, rtol=1e-3, atol=0.1)
    panned = (missed_px(TRUE, tags, views, off + np.array([step, 0.0]))[0] - before) / step
    np.testing.assert_allclose(by_link[:, :, 1, 5], panned, rtol=1e-3, atol=0.1)
    assert len(UNKNOWNS) == 22


@pytest.mark.parametrize("tilt_deg", [-80.0, -45.0, 0.0])
def test_sign_scale_and_tilt_follow_from_single_turns(tilt_deg: float) -> None:
    mount = TRUE.T_mount_camera
    up, left = expected_axes(mount, math.radians(tilt_deg))
    assert tilt_of(mount, up) == pytest.approx(math.radians(tilt_deg))
    shots = seen_from([(0.0, -50.0), (4.0, -50.0), (0.0, -47.0)])
    rough = expected_axes(FILE.T_mount_camera, math.radians(-40.0))
    pan, tilt = turn(LENS, shots[0], shots[1], 0, rough[0]), turn(LENS, shots[0], shots[2], 1, rough[1])
    assert isinstance(pan, Turn)
    assert isinstance(tilt, Turn)
    start = with_turns(FILE, [pan], [tilt], [float(shots[0].reported_rad[1])])
    assert start.axes[0].factor == pytest.approx(-1.36, rel=0.05)
    assert start.axes[1].factor == pytest.approx(0.9, rel=0.05)
    assert float(start.axes[1].line_rad(shots[0].reported_rad[1])) == pytest.approx(math.radians(-50.0), abs=0.05)
    assert left @ up == pytest.approx(0.0)


def test_a_range_holds_the_true_limits_whatever_the_counting() -> None:
    axis = AxisModel(0.3, -1.36, 0.2)
    low, high = safe_range((-1.0, 0.5), axis, 0.3, 0.1, 0.0)
    ends = sorted(float(axis.line_rad(np.array(end))) for end in (low, high))
    assert ends == pytest.approx([-0.9, 0.4])


def test_a_tour_comes_from_both_sides_to_where_tags_are() -> None:
    pans, tilts = np.linspace(0.0, 0.8, 9), np.linspace(-0.5, 0.0, 6)
    shows = np.zeros((9, 6), bool)
    shows[2:7, 3] = True
    row = [stop for stop in tour(pans, tilts, shows) if stop.tilt_rad == tilts[3]]
    looked = [stop.pan_rad for stop in row if stop.look]
    assert looked[:10] == [*pans[2:7], *pans[6:1:-1]]
    assert row[0].pan_rad < pans[2]
    assert not row[0].look


def _run(step: int, speed: float, start_s: float, acceleration: float, rng: np.random.Generator) -> Run:
    stamps = np.arange(-0.4, 3.0, 0.11)
    ramp_s = abs(speed) / acceleration

    def way(since_s: Array) -> Array:
        on = np.clip(since_s, 0.0, ramp_s)
        return math.copysign(0.5 * acceleration, speed) * on**2 + speed * np.maximum(since_s - ramp_s, 0.0)

    reported = way(stamps - start_s) - way(stamps - 1.5) + rng.normal(0.0, 1e-4, len(stamps))
    return Run(0, step, 0.0, 1.5, stamps, np.full(len(stamps), 0.003), reported)


def test_speeds_dead_time_and_acceleration_follow_from_turns() -> None:
    rng = np.random.default_rng(2)
    runs = [_run(sign * step, sign * 0.01 * step, 0.12, 2.0, rng) for step in (2, 10, 40) for sign in (1, -1)]
    still = Run(0, 1, 0.0, 1.5, np.arange(-0.4, 3.0, 0.1), np.zeros(34), np.zeros(34))
    timing = axis_timing([*runs, still])
    assert timing is not None
    assert 1 not in timing.speed_rad_s
    for step in (2, 10, 40, -40):
        assert timing.speed_rad_s[step] == pytest.approx(0.01 * step, rel=0.01)
    assert timing.start_s == pytest.approx(0.12, abs=0.003)
    assert timing.stop_s == pytest.approx(0.0, abs=0.003)
    assert timing.acceleration_rad_s2 == pytest.approx(2.0, rel=0.03)
    assert axis_timing(runs[:2]) is None
