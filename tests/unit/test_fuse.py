"""Tracks: consistency, independence of the order of arrival, the gate, birth, loss and restart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from camrig import fuse
from camrig.fuse.settings import SWERVES_S
from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_z, wrap_angle, yaw_of
from camrig.messages import Event, Fix, Seen, Target, TargetStatus
from camrig.rig import Body, Rig, Space

SETTINGS = fuse.Settings()


def rig_of(motion: str) -> Rig:
    return Rig("test", Space(), {}, targets={"t": Body("t", (), motion)})


ALL_NEW = fuse.Settings(repeating=0.0)
"""Corner noise white in time, as those tests draw it."""

FLOOR, DRIVES, FREE, STATIC = (rig_of(motion) for motion in ("floor", "drives", "free", "static"))
HERE = np.array([1.0, 2.0, 0.0])


def six(position: Array, turn_sigma_rad: float = 0.02) -> Array:
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = position
    covariance[3:, 3:] = turn_sigma_rad**2 * np.eye(3)
    return covariance


def fix(
    stamp_s: float,
    position_m: Array = HERE,
    camera_id: str = "a",
    white: Array | None = None,
    bias: Array | None = None,
    quality_m: float = 0.003,
    yaw_rad: float = 0.0,
) -> Fix:
    """What one camera saw, its own error given by a (3, 3) ``bias``."""
    factors = np.zeros((1, 6, 10))
    factors[0, :, :6] = root(six(1e-6 * np.eye(3) if bias is None else bias, 0.002))
    return Fix(
        target_id="t",
        stamp_s=stamp_s,
        T_world_body=pose.transform(rotation_z(yaw_rad), position_m),
        covariance=six(np.diag([4e-6, 4e-6, 1.6e-5]) if white is None else white),
        sources=(camera_id,),
        factors=factors,
        seen=(Seen(camera_id, stamp_s, quality_m),),
    )


def root(covariance: Array) -> Array:
    """Return the symmetric square root, of a singular matrix too."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def fused(
    fixes: list[Fix], rig: Rig = FLOOR, settings: fuse.Settings = SETTINGS
) -> tuple[fuse.Tracks, tuple[Event, ...]]:
    """Fuse one at a time, as frames arrive."""
    tracks = fuse.Tracks()
    notes: tuple[Event, ...] = ()
    for one in fixes:
        tracks, new = fuse.update(tracks, [one], rig, settings)
        notes += new
    return tracks, notes


def target(tracks: fuse.Tracks, now_s: float, rig: Rig = FLOOR, settings: fuse.Settings = SETTINGS) -> Target:
    (found,) = fuse.targets_at(tracks, rig, now_s, settings)
    return found


def random_covariance(rng: np.random.Generator, sigma_m: float) -> Array:
    A = rng.normal(size=(3, 3))
    return np.asarray(A @ A.T * sigma_m**2 + 0.01 * sigma_m**2 * np.eye(3))


def within_chance(values: list[float], freedoms: int) -> bool:
    """Whether a mean of NEES lies within the two-sided 99.8 % bounds of chi2."""
    n = len(values)
    low, high = (float(chi2.ppf(p, freedoms * n)) / n for p in (0.001, 0.999))
    return bool(low <= np.mean(values) <= high)


def nees(found: Target, truth: Array) -> float:
    error = found.position_m - truth
    return float(error @ np.linalg.solve(found.covariance_m2, error))


# --- consistency ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ["joint", "quality"])
@pytest.mark.parametrize("bias_sigma_m", [0.0, 0.004])
def test_a_static_targets_covariance_is_what_sampling_shows_with_biased_cameras_too(
    estimator: str, bias_sigma_m: float
) -> None:
    """Two cameras, each with an error of its own that stays: however many frames, the published covariance tells."""
    still = fuse.MotionModel((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1e-6)
    options = fuse.Settings(estimator=estimator, models={"static": still}, repeating=0.0)  # type: ignore[arg-type]  # a parameter
    rng = np.random.default_rng(0)
    values, spread, naive = [], [], []
    for _ in range(500):
        white = random_covariance(rng, 0.003)
        shared = {camera: random_covariance(rng, bias_sigma_m) for camera in "ab"}
        bias = {camera: rng.multivariate_normal(np.zeros(3), shared[camera]) for camera in "ab"}
        frames = [
            fix(0.05 * k, HERE + bias[c] + rng.multivariate_normal(np.zeros(3), white), c, white, shared[c])
            for k, c in enumerate("aabab" * 4)
        ]
        tracks, _ = fuse.update(fuse.Tracks(), frames, STATIC, options)
        found = target(tracks, 1.0, STATIC, options)
        values.append(nees(found, HERE))
        spread.append(math.sqrt(np.trace(found.covariance_m2)))
        state = tracks.by_id["t"].state.belief
        assert state is not None
        naive.append(math.sqrt(np.trace(state.modes.whites[0, :3, :3])))
    assert within_chance(values, 3)
    if bias_sigma_m and estimator == "joint":
        assert np.mean(spread) > 1.5 * np.mean(naive)  # what a filter that takes bias for noise would claim


def test_corner_noise_that_repeats_is_not_averaged_away() -> None:
    """A standing tag, a standing camera: most of the corners' error is the same in every one of 20 frames."""
    rng = np.random.default_rng(5)
    values = []
    for _ in range(300):
        white = random_covariance(rng, 0.003)
        same = rng.multivariate_normal(np.zeros(3), 0.8 * white)
        frames = [
            fix(0.05 * k, HERE + same + rng.multivariate_normal(np.zeros(3), 0.2 * white), "a", white, 0.0 * white)
            for k in range(20)
        ]
        values.append(nees(target(fuse.update(fuse.Tracks(), frames, STATIC)[0], 1.0, STATIC), HERE))
    assert within_chance(values, 3)


def test_a_moving_targets_covariance_is_what_sampling_shows() -> None:
    """The truth moves as the model says: drawn from its own transition and noise."""
    rng = np.random.default_rng(1)
    model = fuse.FREE
    F, (Q,), _ = model.step(0.1)
    root = np.linalg.cholesky(Q)
    values = []
    for _ in range(500):
        x = np.concatenate([HERE, rng.normal(size=3)])
        white = random_covariance(rng, 0.01)
        frames = []
        for k in range(15):
            x = F @ x + root @ rng.normal(size=6) if k else x
            seen = x[:3] + rng.multivariate_normal(np.zeros(3), white)
            frames.append(fix(0.1 * k, seen, white=white, bias=np.zeros((3, 3))))
        values.append(nees(target(fused(frames, FREE, ALL_NEW)[0], 1.4, FREE), x[:3]))
    assert within_chance(values, 3)


@pytest.mark.parametrize("model", [fuse.FLOOR, fuse.FREE, fuse.STATIC], ids=["floor", "free", "static"])
@pytest.mark.parametrize(("first_s", "second_s"), [(1e-4, 3e-3), (0.03, 0.07), (0.4, 5.0)])
def test_two_steps_of_a_motion_are_one_step_of_their_sum(
    model: fuse.MotionModel, first_s: float, second_s: float
) -> None:
    (F1, Q1, _), (F2, Q2, _) = model.step(first_s), model.step(second_s)
    F, Q, _ = model.step(first_s + second_s)
    assert pytest.approx(F2 @ F1, abs=1e-12) == F
    if first_s + second_s <= SWERVES_S or len(Q) == 1:
        assert pytest.approx((F2 @ Q1 @ F2.T + Q2)[-1], rel=1e-6, abs=1e-15) == Q[-1]
    assert (np.diagonal(Q[0]) <= np.diagonal(Q[-1])).all()


def test_a_steady_motion_is_followed_without_lag_and_its_speed_known() -> None:
    frames = [fix(0.1 * k, HERE + 0.1 * k * np.array([0.3, -0.1, 0.0])) for k in range(40)]
    found = target(fused(frames)[0], 3.9)
    assert found.position_m == pytest.approx(frames[-1].T_world_body[:3, 3], abs=2e-3)
    assert found.velocity_m_s == pytest.approx([0.3, -0.1, 0.0], abs=0.03)


def test_what_drives_along_an_arc_is_predicted_along_it() -> None:
    """Half a metre a second round a circle of half a metre: a straight line would leave it by 2 cm in 0.2 s."""
    rng = np.random.default_rng(7)

    def on_circle(stamp_s: float) -> tuple[Array, float]:
        return HERE + 0.5 * np.array([math.sin(stamp_s), -math.cos(stamp_s), 0.0]), stamp_s

    frames = []
    for k in range(150):
        place, yaw_rad = on_circle(k / 30.0)
        frames.append(fix(k / 30.0, place + 0.002 * rng.normal(size=3), yaw_rad=yaw_rad + 0.01 * rng.normal()))
    tracks, _ = fused(frames, DRIVES)
    for ahead_s in (0.1, 0.2):
        place, yaw_rad = on_circle(frames[-1].stamp_s + ahead_s)
        found = target(tracks, frames[-1].stamp_s + ahead_s, DRIVES)
        assert found.position_m == pytest.approx(place, abs=0.008)
        assert abs(wrap_angle(yaw_of(found.R_world_body) - yaw_rad)) < 0.06
    motion = fuse.motions(tracks, DRIVES, frames[-1].stamp_s)["t"]
    assert motion.turn_rate_rad_s == pytest.approx(1.0, abs=0.1)
    moved = on_circle(frames[-1].stamp_s - 0.2)[0] - on_circle(frames[-1].stamp_s)[0]
    assert motion.shift_m(-0.2) == pytest.approx(moved, abs=0.006)


@pytest.mark.parametrize("spin_rad_s", [0.5, 1.0, 2.0])
def test_what_slides_while_it_spins_is_no_worse_for_it_unless_the_file_says_that_it_drives(spin_rad_s: float) -> None:
    rng, values = np.random.default_rng(8), []
    tracks = fuse.Tracks()
    for k in range(150):
        place = HERE + np.array([0.04 * k, 0.0, 0.0])
        seen_at = fix(0.1 * k, place + 0.002 * rng.normal(size=3), yaw_rad=0.1 * k * spin_rad_s)
        tracks, _ = fuse.update(tracks, [seen_at], FLOOR)
        found = target(tracks, 0.1 * k + 0.1)
        error_m = found.position_m - place - [0.04, 0.0, 0.0]
        values.append(float(error_m @ np.linalg.solve(found.covariance_m2, error_m)))
    assert max(values[20:]) < 25.0


@pytest.mark.parametrize("rig", [FLOOR, DRIVES], ids=["floor", "drives"])
def test_a_lost_target_is_somewhere_in_the_house(rig: Rig) -> None:
    """However fast it drove and turned: what grows with time grows no faster than it can go."""
    frames = [fix(0.1 * k, HERE + 0.03 * k * np.eye(3)[0], yaw_rad=0.05 * k) for k in range(30)]
    tracks, _ = fused(frames, rig)
    for lost_s in (1.0, 10.0, 60.0, 3600.0):
        found = target(tracks, frames[-1].stamp_s + lost_s, rig)
        sigma_m = math.sqrt(float(np.linalg.eigvalsh(found.covariance_m2)[-1]))
        assert sigma_m < 0.5 * lost_s
        assert np.linalg.norm(found.position_m - HERE) < 1.0 + 0.4 * lost_s


def test_a_body_that_is_picked_up_and_put_down_turned_does_not_spin() -> None:
    frames = [fix(0.1 * k, yaw_rad=0.0 if k < 20 else 2.5) for k in range(23)]
    assert abs(fuse.motions(fused(frames, DRIVES)[0], DRIVES, 2.2)["t"].turn_rate_rad_s) < 0.2


def test_a_floor_targets_height_is_learnt_and_helps_its_place() -> None:
    """A camera looking down at 45 deg errs along its ray: height known, the place along it is known as well."""
    ray = np.array([1.0, 0.0, -1.0]) / math.sqrt(2.0)
    white = 1e-4 * np.outer(ray, ray) + 1e-7 * np.eye(3)
    rng = np.random.default_rng(2)
    frames = [
        fix(0.1 * k, HERE + rng.multivariate_normal(np.zeros(3), white), white=white, bias=np.zeros((3, 3)))
        for k in range(60)
    ]
    on_floor, in_space = (target(fused(frames, rig, ALL_NEW)[0], 5.9, rig) for rig in (FLOOR, FREE))
    assert on_floor.covariance_m2[0, 0] < 0.3 * in_space.covariance_m2[0, 0]
    assert on_floor.position_m == pytest.approx(HERE, abs=0.006)


def test_innovations_tell_whether_fixes_come_where_they_are_expected() -> None:
    """About 1 where covariances are right, far above where the motion or a camera is not what it is taken for."""
    rng, quiet, wild = np.random.default_rng(4), fuse.Tracks(), fuse.Tracks()
    for k in range(100):
        place = HERE + rng.normal(size=3) * [0.002, 0.002, 0.004]
        quiet, _ = fuse.update(quiet, [fix(k / 10.0, place)], STATIC, ALL_NEW)
        wild, _ = fuse.update(wild, [fix(k / 10.0, place + 0.008 * (-1) ** k * np.eye(3)[0])], STATIC, ALL_NEW)
    (calm,), (odd,) = (fuse.targets_at(tracks, STATIC, 10.0) for tracks in (quiet, wild))
    assert calm.innovation is not None
    assert odd.innovation is not None
    assert 0.5 < calm.innovation < 2.0
    assert odd.innovation > 4.0


def test_the_papers_weighting_follows_quality_and_not_covariance() -> None:
    good, poor = HERE, HERE + np.array([0.03, 0.0, 0.0])
    vague = np.diag([1e-2] * 3)
    frames = [fix(0.0, good, "a", vague, quality_m=0.002), fix(0.0, poor, "b", vague, quality_m=0.004)]
    options = replace(SETTINGS, estimator="quality")
    found = target(fuse.update(fuse.Tracks(), frames, STATIC, options)[0], 0.0, STATIC, options)
    share = (found.position_m - HERE)[0] / 0.03
    # begun with the first fix's covariance, then weighed by Q^2: the second counts in full
    assert share > 0.9
    assert found.quality_m == pytest.approx(1.0 / (1.0 / 0.002 + 1.0 / 0.004))


# --- the order of arrival -------------------------------------------------------------------------------


def scattered(seed: int, n: int = 12) -> list[Fix]:
    """Sightings of two cameras at odd times, some far off: births, gates and restarts included."""
    rng = np.random.default_rng(seed)
    frames, place = [], HERE
    for _ in range(n):
        place = place + (rng.normal(size=3) if rng.uniform() < 0.2 else 0.0)
        white = random_covariance(rng, 0.05 if rng.uniform() < 0.3 else 0.003)
        stamp_s = float(rng.uniform(0.0, 0.65))
        frames.append(fix(stamp_s, place + 0.003 * rng.normal(size=3), str(rng.choice(["a", "b"])), white))
    return frames


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.randoms(use_true_random=False))
def test_the_result_does_not_depend_on_the_order_of_arrival(seed: int, shuffler: object) -> None:
    frames = scattered(seed)
    shuffled = list(frames)
    shuffler.shuffle(shuffled)  # type: ignore[attr-defined]  # random.Random, which hypothesis hands in untyped
    start = [fix(-0.01), *frames]
    one, other = fused(start)[0], fused([start[0], *shuffled])[0]
    assert_same(one, other)
    # And so it stays once everything has left the buffer.
    later = [fix(2.0 + 0.1 * k) for k in range(12)]
    assert_same(fuse.update(one, later, FLOOR)[0], fuse.update(other, later, FLOOR)[0])


def assert_same(one: fuse.Tracks, other: fuse.Tracks) -> None:
    a, b = target(one, 5.0), target(other, 5.0)
    assert np.array_equal(a.position_m, b.position_m, equal_nan=True)
    assert np.array_equal(a.covariance_m2, b.covariance_m2)
    assert np.array_equal(a.R_world_body, b.R_world_body, equal_nan=True)
    assert (a.status, a.seen_by, a.last_seen_s) == (b.status, b.seen_by, b.last_seen_s)


def test_a_fix_too_late_is_dropped_and_reported() -> None:
    frames = [fix(0.1 * k) for k in range(20)]
    tracks, _ = fused(frames)
    same, notes = fuse.update(tracks, [fix(1.0, HERE + 1.0, "slow")], FLOOR)
    assert same.by_id == tracks.by_id
    (note,) = notes
    assert note.about == "t"
    assert "slow" in note.text
    assert "0.7 s late" in note.text


def test_the_same_fix_twice_counts_once() -> None:
    frames = [fix(0.0), fix(0.1), fix(0.1), fix(0.2)]
    assert_same(fused(frames)[0], fused([frames[0], frames[1], frames[3]])[0])


def test_the_buffer_stays_short() -> None:
    tracks, _ = fused([fix(0.05 * k) for k in range(200)])
    track = tracks.by_id["t"]
    assert len(track.fixes) == len(track.states) <= 15


# --- birth, gate, loss ----------------------------------------------------------------------------------

VAGUE = np.diag([0.1**2] * 3)


def test_nobody_has_seen_it() -> None:
    found = target(fuse.Tracks(), 3.0)
    assert (found.id, found.status, found.stamp_s) == ("t", TargetStatus.UNSEEN, 3.0)
    assert np.isnan(found.position_m).all()
    assert np.isnan(found.R_world_body).all()
    assert np.isinf(np.diag(found.covariance_m2)).all()
    assert (found.seen_by, found.last_seen_s, found.quality_m) == ((), -math.inf, None)


def test_a_good_first_fix_is_enough() -> None:
    found = target(fused([fix(1.0)])[0], 1.1)
    assert (found.status, found.seen_by, found.last_seen_s) == (TargetStatus.TRACKED, ("a",), 1.0)
    assert found.position_m == pytest.approx(HERE)
    assert found.quality_m == pytest.approx(0.003)


def test_a_vague_one_waits_for_a_second_that_agrees() -> None:
    first, elsewhere, agreeing = (
        fix(1.0, white=VAGUE),
        fix(1.1, HERE + 2.0, white=VAGUE),
        fix(1.2, HERE + 2.05, white=VAGUE),
    )
    tracks, _ = fused([first, elsewhere])
    assert target(tracks, 1.1).status is TargetStatus.UNSEEN
    assert fuse.predicted_poses(tracks, 1.1) == {}
    found = target(fused([first, elsewhere, agreeing])[0], 1.2)
    assert found.status is TargetStatus.TRACKED
    assert found.position_m == pytest.approx(HERE + 2.025, abs=0.02)


def test_a_vague_one_that_stays_alone_is_forgotten() -> None:
    tracks, _ = fused([fix(1.0, white=VAGUE), fix(9.0, white=VAGUE)])
    assert target(tracks, 9.0).status is TargetStatus.UNSEEN


def test_one_wild_fix_does_not_move_a_track() -> None:
    steady = [fix(0.1 * k) for k in range(10)]
    wild = fix(0.95, HERE + np.array([0.5, 0.0, 0.0]), "b")
    found = target(fused([*steady, wild, fix(1.0)])[0], 1.0)
    assert found.position_m == pytest.approx(HERE, abs=1e-6)
    assert found.seen_by == ("a",)


def test_a_camera_that_errs_for_ever_does_not_win_while_another_agrees_with_the_track() -> None:
    frames = [fix(0.05 * k, HERE + (k % 2) * np.array([0.5, 0.0, 0.0]), "b" if k % 2 else "a") for k in range(60)]
    tracks, notes = fused(frames)
    assert notes == ()
    assert target(tracks, 3.0).position_m == pytest.approx(HERE, abs=1e-3)


def test_a_target_picked_up_and_put_down_elsewhere_is_found_there_and_reported() -> None:
    there = HERE + np.array([1.5, -0.5, 0.0])
    before = [fix(0.1 * k) for k in range(20)]
    after = [fix(2.0 + 0.1 * k, there + 0.001 * k) for k in range(4)]
    tracks, notes = fused([*before, *after[:2]])
    assert notes == ()
    assert target(tracks, 2.1).position_m == pytest.approx(HERE, abs=0.01)
    tracks, notes = fused([*before, *after])
    assert [note.about for note in notes] == ["t"]
    assert "restarted" in notes[0].text
    assert target(tracks, 2.3).position_m == pytest.approx(there, abs=0.01)


def test_out_of_sight_it_is_lost_after_a_time_and_ever_less_certain_and_found_again() -> None:
    tracks, _ = fused([fix(0.1 * k) for k in range(10)])
    soon, late, later = (target(tracks, now_s) for now_s in (1.8, 2.0, 30.0))
    assert [one.status for one in (soon, late, later)] == [TargetStatus.TRACKED, TargetStatus.LOST, TargetStatus.LOST]
    assert late.last_seen_s == 0.9
    assert late.seen_by == ()
    assert late.quality_m is None
    sizes = [float(np.trace(one.covariance_m2)) for one in (soon, late, later)]
    assert sizes == sorted(sizes)
    # A robot at 0.3 m/s is somewhere within metres after half a minute, not kilometres.
    assert 1.0 < math.sqrt(sizes[2]) < 10.0
    again = fix(30.0, HERE + np.array([4.0, -1.0, 0.0]))
    found = target(fuse.update(tracks, [again], FLOOR)[0], 30.0)
    assert found.status is TargetStatus.TRACKED
    assert found.position_m == pytest.approx(again.T_world_body[:3, 3], abs=0.01)


def test_a_lost_target_far_from_anywhere_it_could_be_is_started_anew() -> None:
    tracks, _ = fused([fix(0.1 * k) for k in range(10)])
    again = fix(4.0, HERE + 50.0)
    found = target(fuse.update(tracks, [again], FLOOR)[0], 4.0)
    assert found.position_m == pytest.approx(HERE + 50.0)


def test_a_static_target_loses_next_to_nothing_while_nobody_looks() -> None:
    frames = [fix(0.1 * k) for k in range(10)]
    tracks, _ = fused(frames, STATIC)
    now, later = target(tracks, 0.9, STATIC), target(tracks, 60.0, STATIC)
    assert later.position_m == pytest.approx(now.position_m)
    assert np.trace(later.covariance_m2) < np.trace(now.covariance_m2) + 3e-6


def test_a_tick_before_the_newest_fix_is_answered_at_its_stamp() -> None:
    found = target(fused([fix(1.0)])[0], 0.95)
    assert (found.stamp_s, found.status) == (1.0, TargetStatus.TRACKED)


def test_predicted_poses_carry_place_and_heading_on() -> None:
    frames = [fix(0.1 * k, HERE + 0.1 * k * np.array([0.3, 0.0, 0.0]), yaw_rad=0.5) for k in range(30)]
    poses = fuse.predicted_poses(fused(frames)[0], 3.0)
    assert set(poses) == {"t"}
    assert poses["t"][:3, 3] == pytest.approx(HERE + np.array([0.9, 0.0, 0.0]), abs=5e-3)
    assert yaw_of(poses["t"][:3, :3]) == pytest.approx(0.5)


def test_the_heading_is_averaged_while_it_stands_and_followed_when_it_turns() -> None:
    rng = np.random.default_rng(4)
    still = [fix(0.1 * k, yaw_rad=0.3 + 0.02 * rng.normal()) for k in range(100)]
    R = target(fused(still, STATIC)[0], 9.9, STATIC).R_world_body
    assert yaw_of(R) == pytest.approx(0.3, abs=0.008)
    turning = [fix(0.1 * k, yaw_rad=0.1 * k) for k in range(20)]
    assert yaw_of(target(fused(turning)[0], 1.9).R_world_body) == pytest.approx(1.9, abs=0.03)
