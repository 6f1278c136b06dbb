"""Targets that go on calmly and at times brake, start or swerve: followed in both, and never surely placed wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig import fuse
from camrig.fuse.modes import Modes
from camrig.geometry.arrays import Array
from camrig.geometry.pose import transform
from camrig.messages import Fix, Seen, Target
from camrig.rig import Body, Rig, Space

FIX_S, AHEAD_S = 1.0 / 30.0, 0.1
CRUISE_M_S, BRAKES_M_S2, BRAKES_AT_S = 0.5, 2.0, 3.0
OPTIONS = fuse.Settings(repeating=0.0)
MOTIONS = pytest.mark.parametrize("motion", ["floor", "drives"])
seeds = st.integers(0, 2**32 - 1)


def rig_of(motion: str) -> Rig:
    return Rig("test", Space(), {}, {}, {}, {"t": Body("t", (), motion)}, ())


def braking(stamp_s: float) -> Array:
    """Drive along x, brake at 3 s, and stand."""
    braked_s = min(max(stamp_s - BRAKES_AT_S, 0.0), CRUISE_M_S / BRAKES_M_S2)
    return np.array(
        [CRUISE_M_S * min(stamp_s, BRAKES_AT_S) + (CRUISE_M_S - 0.5 * BRAKES_M_S2 * braked_s) * braked_s, 0, 0]
    )


def followed(
    way: Callable[[float], Array], motion: str, options: fuse.Settings, seed: int, sigma_m: float
) -> list[tuple[float, Target]]:
    """Return, by time, what is published a tenth of a second after each fix for the time at which it is."""
    rng, rig, tracks = np.random.default_rng(seed), rig_of(motion), fuse.Tracks()
    found: list[tuple[float, Target]] = []
    covariance = np.diag([sigma_m**2] * 3 + [1e-4] * 3)
    for k in range(150):
        stamp_s = k * FIX_S
        T = transform(np.eye(3), way(stamp_s) + sigma_m * rng.normal(size=3))
        fix = Fix("t", stamp_s, T, covariance, ("a",), np.zeros((1, 6, 10)), (Seen("a", stamp_s, 0.01),))
        tracks, notes = fuse.update(tracks, [fix], rig, options)
        assert not notes or stamp_s < 1.0, "it is never taken for one that was carried away"
        (target,) = fuse.targets_at(tracks, rig, stamp_s + AHEAD_S, options)
        found.append((stamp_s + AHEAD_S, target))
    return found


def nees(target: Target, truth: Array) -> float:
    error = (target.position_m - truth)[:2]
    return float(error @ np.linalg.solve(target.covariance_m2[:2, :2], error))


@MOTIONS
def test_what_brakes_hard_is_never_surely_placed_wrong_and_soon_known_to_stand(motion: str) -> None:
    """Guessed ahead by a tenth of a second, what just brakes is a centimetre and more from there, and nobody knows."""
    for seed in range(8):
        found = followed(braking, motion, OPTIONS, seed, 0.0003)
        assert max(nees(target, braking(now_s)) for now_s, target in found if now_s > 1.0) < 36.0
        stood = [target for now_s, target in found if now_s > BRAKES_AT_S + 0.25 + AHEAD_S + 0.2]
        assert max(abs(target.velocity_m_s[0]) for target in stood) < 0.05
        before = next(target for now_s, target in found if now_s > BRAKES_AT_S)
        assert np.trace(found[-1][1].covariance_m2) < 1.1 * np.trace(before.covariance_m2)


@MOTIONS
def test_what_goes_on_calmly_is_placed_as_well_as_if_nothing_ever_swerved(motion: str) -> None:
    model = OPTIONS.models[motion]
    calm = replace(OPTIONS, models={motion: replace(model, swerve_m2_s3=0.0)})

    def along(stamp_s: float) -> Array:
        return np.array([CRUISE_M_S * stamp_s, 0.0, 0.0])

    def rms_m(options: fuse.Settings) -> float:
        off = [
            target.position_m - along(now_s)
            for seed in range(8)
            for now_s, target in followed(along, motion, options, seed, 0.001)
            if now_s > 1.0
        ]
        return float(np.sqrt(np.mean(np.square(off))))

    assert rms_m(OPTIONS) < 1.2 * rms_m(calm)


def test_where_it_does_what_the_model_says_its_covariance_is_what_sampling_shows() -> None:
    """Velocity and swerves drawn from the model, 400 ways of a second and a half; a filter of all that is a mixture of
    ever more, of which two are kept, so NEES is nearly what it must be (2).
    """
    rng, model, rig = np.random.default_rng(3), fuse.FLOOR, rig_of("floor")
    plane, step_s, every, values = [0, 1, 3, 4], FIX_S / 4.0, 4, []
    F, (Q, swerved), _ = model.step(step_s)
    roots = [np.linalg.cholesky(each[np.ix_(plane, plane)]) for each in (Q, swerved)]
    for _ in range(400):
        x, swerves, tracks = np.zeros(6), bool(rng.uniform() < model.often[1]), fuse.Tracks()
        x[3:5] = rng.normal(size=2) * np.sqrt(np.diag(model.velocity_covariance)[:2])
        for k in range(45 * every + 1):
            if k % every == 0:
                T = transform(np.eye(3), x[:3] + 0.001 * rng.normal(size=3))
                covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
                fix = Fix("t", k * step_s, T, covariance, ("a",), np.zeros((1, 6, 10)), (Seen("a", k * step_s, 0.01),))
                tracks, _ = fuse.update(tracks, [fix], rig, OPTIONS)
            x = F @ x
            x[plane] += roots[swerves] @ rng.normal(size=4)
            swerves ^= bool(rng.uniform() < step_s / (model.swerve_s if swerves else model.calm_s))
        (target,) = fuse.targets_at(tracks, rig, (45 * every + 1) * step_s, OPTIONS)
        values.append(nees(target, x[:3]))
    assert 1.6 < np.mean(values) < 2.6


# --- the mixture --------------------------------------------------------------------------------------------


def drawn(seed: int) -> Modes:
    rng = np.random.default_rng(seed)
    weight, A = rng.uniform(0.01, 0.99), rng.normal(size=(2, 6, 6))
    whites = A @ A.swapaxes(1, 2) + 0.1 * np.eye(6)
    return Modes(np.array([weight, 1.0 - weight]), rng.normal(size=(2, 6)), whites, rng.normal(size=(2, 6, 20)))


@given(seeds)
def test_mixing_changes_neither_mean_nor_covariance_of_the_whole(seed: int) -> None:
    modes = drawn(seed)
    stays = np.random.default_rng(seed).uniform(0.01, 0.99, size=2)
    mixed = modes.mixed(np.array([[stays[0], 1.0 - stays[0]], [1.0 - stays[1], stays[1]]]))
    assert mixed.weights.sum() == pytest.approx(1.0)
    assert mixed.mean == pytest.approx(modes.mean)
    assert mixed.covariance == pytest.approx(modes.covariance)


@given(seeds)
def test_a_fix_makes_the_mode_that_foretold_it_more_probable_and_all_surer(seed: int) -> None:
    modes = drawn(seed)
    measured = modes.means[0, :3]
    C, factors = 0.01 * np.eye(3), np.zeros((3, 20))
    modes = replace(modes, whites=np.stack([modes.whites[0]] * 2), sensitivities=np.zeros((2, 6, 20)))
    taken = modes.taken(measured, C, factors, np.zeros((3, 3)))
    assert taken.weights[0] >= modes.weights[0]
    assert taken.weights.sum() == pytest.approx(1.0)
    for after, before in zip(taken.covariances, modes.covariances, strict=True):
        assert np.linalg.eigvalsh(before - after).min() > -1e-9
        assert np.linalg.eigvalsh(after).min() > 0.0


def test_where_nothing_swerves_there_is_one_mode() -> None:
    for model in (fuse.STATIC, fuse.FREE):
        _, noise, becomes = model.step(0.1)
        assert noise.shape == (1, 6, 6)
        assert becomes == pytest.approx(np.ones((1, 1)))
        assert model.often == pytest.approx([1.0])


@pytest.mark.parametrize("model", [fuse.FLOOR, fuse.DRIVES])
def test_swerves_are_as_often_as_is_said_however_long_one_waits(model: fuse.MotionModel) -> None:
    for dt_s in (1e-4, 0.03, 0.5, 100.0):
        *_, becomes = model.step(dt_s)
        assert becomes.sum(axis=1) == pytest.approx([1.0, 1.0])
        assert model.often @ becomes == pytest.approx(model.often)
    assert becomes == pytest.approx(np.stack([model.often] * 2), abs=0.01)
    *_, soon = model.step(1e-4)
    assert soon[0, 1] == pytest.approx(0.5e-4 / model.calm_s, rel=1e-3), "half of it, on the average until then"
    assert math.isclose(soon[1, 0], 0.5e-4 / model.swerve_s, rel_tol=1e-3)
