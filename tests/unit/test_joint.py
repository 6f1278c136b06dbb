"""Cameras and bodies estimated together: how good, how honest, and what happens to views that contradict each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from camrig import fuse
from camrig.geometry.arrays import Array
from camrig.geometry.pose import perturb, transform
from camrig.geometry.rotation import rotation_x, rotation_z
from camrig.locate import Together, View, apart, joint
from camrig.locate.tags import SeenTag
from camrig.messages import Fix, Motion, TargetStatus
from camrig.rig import Rig
from tests.watched_floor import Errors, Floor

POINTING = Errors(math.radians(0.2))
ALL_WRONG = Errors(math.radians(0.1), mounts=True, lenses=True)


def at_rest(floor: Floor) -> dict[str, Motion]:
    """Return that no body's place is known yet, and that none moves."""
    still = np.zeros(3)
    return {name: Motion(1.0, None, still, np.zeros((3, 3)), still, still) for name in floor.rig.targets}


def together(floor: Floor, views: list[View] | None = None) -> Together:
    return joint(views or floor.views(), (), at_rest(floor), floor.rig)


def error_m(fix: Fix, floor: Floor) -> Array:
    return np.asarray(fix.T_world_body[:3, 3] - floor.places[fix.target_id][:3, 3])


def nees(fix: Fix, floor: Floor) -> float:
    error = error_m(fix, floor)
    return float(error @ np.linalg.solve(fix.whole[:3, :3], error))


# --- how good -----------------------------------------------------------------------------------------------


def test_without_any_error_it_is_exact() -> None:
    floor = Floor(1, cameras=3, bodies=5)
    exact = [floor.view(name, noise=0.0) for name in floor.rig.cameras]
    for fix in together(floor, exact).fixes:
        assert float(np.abs(error_m(fix, floor)).max()) < 1e-6


@pytest.mark.parametrize("anchors", [False, True])
def test_heads_that_point_badly_are_put_right_by_what_they_see_in_common(anchors: bool) -> None:
    """0.2 deg of pointing error: the mean of what single cameras say is off by millimetres."""
    joint_mm, mean_mm = [], []
    for seed in range(12):
        floor = Floor(seed, cameras=5, bodies=10, anchors=anchors, errors=POINTING)
        views = floor.views()
        joint_mm += [1e3 * float(np.hypot(*error_m(fix, floor)[:2])) for fix in together(floor, views).fixes]
        single: dict[str, list[Array]] = {}
        for fix in apart(views).fixes:
            single.setdefault(fix.target_id, []).append(error_m(fix, floor))
        mean_mm += [1e3 * float(np.hypot(*np.mean(errors, axis=0)[:2])) for errors in single.values()]
    assert len(joint_mm) >= 110
    assert float(np.mean(joint_mm)) < (0.2 if anchors else 0.8)
    assert float(np.mean(joint_mm)) < 0.3 * float(np.mean(mean_mm))


def test_bodies_whose_height_is_known_are_placed_better_without_anchors() -> None:
    free_mm: list[float] = []
    known_mm: list[float] = []
    for seed in range(8):
        for known_height, errors_mm in ((False, free_mm), (True, known_mm)):
            floor = Floor(seed, cameras=5, bodies=10, known_height=known_height, errors=POINTING)
            for fix in together(floor, floor.views()).fixes:
                error = error_m(fix, floor)
                errors_mm.append(1e3 * float(np.hypot(*error[:2])))
                assert float(error @ np.linalg.solve(fix.whole[:3, :3], error)) < 25.0
    assert float(np.mean(known_mm)) < 0.9 * float(np.mean(free_mm))


# --- how honest ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("anchors", [False, True])
def test_its_covariance_tells_what_is_wrong_with_heads_mounts_and_lenses(anchors: bool) -> None:
    """Average NEES of one body a scene (those of one scene share their cameras' errors) within its 99.8 % bounds."""
    values, worst = [], 0.0
    for seed in range(60):
        floor = Floor(100 + seed, cameras=4, bodies=6, anchors=anchors, errors=ALL_WRONG)
        found = [nees(fix, floor) for fix in together(floor).fixes]
        values.append(found[0])
        worst = max(worst, *found)
    low, high = (float(chi2.ppf(p, 3 * len(values))) / len(values) for p in (0.001, 0.999))
    assert low <= np.mean(values) <= high
    assert worst < 25.0


def test_what_a_cameras_error_does_is_told_apart_by_camera() -> None:
    """A fix's factors are what moving one camera's prior by one sigma does to it."""
    floor = Floor(5, cameras=3, bodies=5, errors=POINTING)
    views = floor.views()
    before = {fix.target_id: fix for fix in together(floor, views).fixes}
    carried = views[0].carried
    assert carried is not None
    root = np.linalg.cholesky(carried.covariance)
    for k in (3, 4, 5):
        off = replace(carried, T_world_camera=perturb(carried.T_world_camera, np.asarray(0.1 * root[:, k], float)))
        after = together(floor, [replace(views[0], carried=off), *views[1:]]).fixes
        for fix in after:
            was = before[fix.target_id]
            predicted = 0.1 * was.factors[was.sources.index("c0"), :3, k]
            assert fix.T_world_body[:3, 3] - was.T_world_body[:3, 3] == pytest.approx(predicted, abs=2e-5)


# --- contradictions -----------------------------------------------------------------------------------------


def test_a_tag_twice_its_declared_size_is_named_and_not_used() -> None:
    """Each camera alone believes it, at half its distance; together they cannot."""
    floor = Floor(2, cameras=4, bodies=5, anchors=True)
    body = floor.rig.targets["b0"]
    half = tuple(replace(tag, size_m=0.5 * tag.size_m) for tag in body.tags)
    wrong = replace(floor.rig, targets={**floor.rig.targets, "b0": replace(body, tags=half)})
    views = [floor.view(name, rig=wrong) for name in floor.rig.cameras]
    assert sum("b0" in (seen.body.id for seen in view.bodies) for view in views) >= 2
    found = joint(views, (), at_rest(floor), wrong)
    assert "b0" not in {fix.target_id for fix in found.fixes}
    assert [note.about for note in found.notes] == ["b0"]
    assert "do not agree" in found.notes[0].text
    for fix in found.fixes:
        assert nees(fix, floor) < 30.0


def test_one_camera_of_many_that_is_wrong_about_a_body_is_left_out() -> None:
    floor = Floor(4, cameras=6, bodies=4, anchors=True)
    views = [floor.view(name) for name in floor.rig.cameras]
    k = next(k for k, view in enumerate(views) if any(seen.body.id == "b1" for seen in view.bodies))
    elsewhere = floor.places["b1"].copy()
    elsewhere[:3, 3] += [0.0, 0.15, 0.0]
    views[k] = floor.view(views[k].camera_id, places={**floor.places, "b1": elsewhere})
    fix = next(fix for fix in together(floor, views).fixes if fix.target_id == "b1")
    assert float(np.linalg.norm(error_m(fix, floor))) < 0.002


def test_a_body_that_one_camera_sees_turned_over_is_placed_as_the_others_see_it() -> None:
    """The two poses of one tag: of a body that is free to turn, cameras outvote one that chose the wrong one."""
    floor = Floor(6, cameras=4, bodies=3, anchors=True)
    free = {name: replace(body, motion="free") for name, body in floor.rig.targets.items()}
    rig = replace(floor.rig, targets=free)
    views = [floor.view(name, rig=rig) for name in rig.cameras]
    name = "b0"
    flipped = [
        replace(s, T_world_body=_turned(s.T_world_body))
        if s.target_id == name and s.camera_id == views[0].camera_id
        else s
        for s in views[0].sightings
    ]
    views[0] = replace(views[0], sightings=tuple(flipped))
    fix = next(fix for fix in joint(views, (), at_rest(floor), rig).fixes if fix.target_id == name)
    assert float(np.abs(fix.T_world_body[:3, :3] - floor.places[name][:3, :3]).max()) < 0.02


def _turned(T: Array) -> Array:
    return transform(T[:3, :3] @ rotation_x(0.7), T[:3, 3])


# --- time ---------------------------------------------------------------------------------------------------


def test_older_views_hold_the_cameras_and_fresh_ones_place_the_bodies() -> None:
    floor = Floor(7, cameras=3, bodies=4, errors=POINTING)
    views = floor.views()
    old = [replace(view, stamp_s=0.9) for view in views[1:]]
    alone = joint(views[:1], (), at_rest(floor), floor.rig)
    helped = joint(views[:1], old, at_rest(floor), floor.rig)
    assert {fix.target_id for fix in helped.fixes} == {fix.target_id for fix in alone.fixes}
    assert all(fix.stamp_s == 1.0 for fix in helped.fixes)
    assert [pose.camera_id for pose in helped.camera_poses] == ["c0"]
    for with_others, without in zip(helped.fixes, alone.fixes, strict=True):
        assert np.trace(with_others.whole[:3, :3]) < np.trace(without.whole[:3, :3])
    too_old = [replace(view, stamp_s=0.5) for view in views[1:]]
    for fix, same in zip(joint(views[:1], too_old, at_rest(floor), floor.rig).fixes, alone.fixes, strict=True):
        assert fix.T_world_body == pytest.approx(same.T_world_body)


def test_a_body_that_moves_is_placed_where_it_is_at_the_fresh_frame() -> None:
    """Seen by one camera 80 ms before the other, at 0.5 m/s: the shift is made good by what is known of its motion."""
    floor = Floor(8, cameras=4, bodies=3, anchors=True)
    velocity = np.array([0.5, 0.0, 0.0])
    before = {name: transform(T[:3, :3], T[:3, 3] - 0.08 * velocity) for name, T in floor.places.items()}
    names = list(floor.rig.cameras)
    fresh = [floor.view(name) for name in names[:2]]
    old = [replace(floor.view(name, places=before), stamp_s=0.92) for name in names[2:]]
    moving = {
        name: Motion(1.0, None, velocity, 4e-4 * np.eye(3), np.full(3, 0.018), np.array([0.0, 0.0, 0.5]))
        for name in floor.rig.targets
    }
    for fix in joint(fresh, old, moving, floor.rig).fixes:
        assert float(np.linalg.norm(error_m(fix, floor)[:2])) < 0.001


def test_a_body_that_turns_between_two_frames_is_no_further_for_it() -> None:
    """5 degrees between each two: a tag so turned is 0.4 % narrower, which is not to be taken for a centimetre."""
    values, off_m = [], []
    for seed in range(8):
        floor = Floor(60 + seed, cameras=3, bodies=3, anchors=True)
        motions = {
            name: Motion(1.0, None, np.zeros(3), np.diag([2e-3, 2e-3, 0.0]), np.zeros(3), np.array([0.0, 0.0, 0.5]))
            for name in floor.rig.targets
        }
        views = []
        for k, name in enumerate(floor.rig.cameras):
            turned = {
                body: transform(rotation_z(-k * math.radians(5.0)) @ T[:3, :3], T[:3, 3])
                for body, T in floor.places.items()
            }
            views.append(replace(floor.view(name, places=turned), stamp_s=1.0 - 0.04 * k))
        for fix in joint(views[:1], views[1:], motions, floor.rig).fixes:
            error = error_m(fix, floor)
            off_m.append(float(np.linalg.norm(error)))
            values.append(float(error @ np.linalg.solve(fix.whole[:3, :3], error)))
    assert np.mean(values) <= float(chi2.ppf(0.999, 3 * len(values))) / len(values)
    assert np.quantile(off_m, 0.9) < 0.004


def test_nothing_seen_tells_nothing() -> None:
    floor = Floor(9, cameras=2, bodies=2)
    assert joint((), floor.views(), at_rest(floor), floor.rig) == Together()
    blind = [replace(view, bodies=(), sightings=()) for view in floor.views()]
    found = joint(blind, (), at_rest(floor), floor.rig)
    assert found.fixes == ()
    assert [pose.camera_id for pose in found.camera_poses] == ["c0", "c1"]


def test_the_track_of_a_body_is_as_good_as_its_fixes() -> None:
    """Twenty rounds of the same cameras with the same errors: what stays the same is never averaged away."""
    values = []
    for seed in range(25):
        floor = Floor(200 + seed, cameras=3, bodies=3, errors=ALL_WRONG)
        still = {name: replace(body, motion="static") for name, body in floor.rig.targets.items()}
        rig = replace(floor.rig, targets=still)
        tracks = fuse.Tracks()
        for k in range(20):
            stamp_s = 1.0 + 0.005 * k
            views = [floor.view(name, stamp_s=stamp_s, rig=rig) for name in rig.cameras]
            motions = fuse.motions(tracks, rig, stamp_s)
            tracks, _ = fuse.update(tracks, joint(views, (), motions, rig).fixes, rig)
        target = next(each for each in fuse.targets_at(tracks, rig, 1.1) if each.status is TargetStatus.TRACKED)
        error = target.position_m - floor.places[target.id][:3, 3]
        values.append(float(error @ np.linalg.solve(target.covariance_m2, error)))
    assert np.mean(values) <= float(chi2.ppf(0.999, 3 * len(values))) / len(values)
    assert max(values) < 25.0


# --- little is known ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("sigma_m", "sigma_rad"), [(1.0, 0.2), (3.0, 0.2), (10.0, 0.5)])
def test_carriers_that_know_next_to_nothing_leave_a_covariance_all_the_same(sigma_m: float, sigma_rad: float) -> None:
    prior = np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    for seed in range(20):
        floor = Floor(300 + seed, cameras=3, bodies=4)
        views = [replace(view, carried=replace(view.found, covariance=prior)) for view in floor.views()]
        fixes = together(floor, views).fixes
        for fix in fixes:
            np.linalg.cholesky(fix.covariance)
        fuse.update(fuse.Tracks(), fixes, floor.rig)


def test_a_camera_that_nothing_holds_any_more_tells_nothing() -> None:
    """Hand-carried, its one anchor moved: whoever is left hangs on the others, or is not believed."""
    for seed in range(40):
        floor = Floor(400 + seed, cameras=4, bodies=4, anchors=True)
        rng = np.random.default_rng(seed)
        moved = tuple(
            replace(each, T_world_tag=perturb(each.T_world_tag, np.append(rng.normal(size=3) * 0.3, np.zeros(3))))
            for each in floor.rig.anchors
        )
        wrong = replace(floor.rig, anchors=moved)
        views = floor.views()
        free = [
            replace(view, carried=None, anchors=tuple(_placed_as(tag, wrong) for tag in view.anchors[:1]))
            for view in views[:3]
            if view.anchors
        ]
        found = joint([*free, views[3]], (), at_rest(floor), wrong)
        for pose in found.camera_poses:
            assert np.linalg.eigvalsh(pose.covariance)[0] > 0.0
        fuse.update(fuse.Tracks(), found.fixes, floor.rig)


def _placed_as(tag: SeenTag, rig: Rig) -> SeenTag:
    anchor = next(each for each in rig.anchors if each.key == tag.key)
    owner = replace(tag.owner, T_owner_tag=anchor.T_world_tag)
    return replace(tag, owner=owner, corners_m=owner.corners_m)


def test_a_robot_that_turned_round_unseen_is_found_again() -> None:
    floor = Floor(11, cameras=1, bodies=3)
    (view,) = floor.views()
    behind = {
        name: replace(motion, T_world_body=transform(T[:3, :3] @ rotation_z(math.pi), T[:3, 3] + [2.0, 0.0, 0.0]))
        for (name, motion), T in zip(at_rest(floor).items(), floor.places.values(), strict=True)
    }
    found = joint([view], (), behind, floor.rig)
    assert {fix.target_id for fix in found.fixes} == {seen.body.id for seen in view.bodies}
    assert found.notes == ()
    for fix in found.fixes:
        assert float(np.linalg.norm(error_m(fix, floor))) < 0.01


def test_one_contradiction_is_told_in_the_same_words_whoever_is_fresh() -> None:
    floor = Floor(2, cameras=4, bodies=5, anchors=True)
    body = floor.rig.targets["b0"]
    half = tuple(replace(tag, size_m=0.5 * tag.size_m) for tag in body.tags)
    wrong = replace(floor.rig, targets={**floor.rig.targets, "b0": replace(body, tags=half)})
    views = [floor.view(name, rig=wrong) for name in floor.rig.cameras]
    texts = {
        note.text
        for k in range(4)
        for note in joint([views[k]], [*views[:k], *views[k + 1 :]], at_rest(floor), wrong).notes
    }
    assert len(texts) == 1
