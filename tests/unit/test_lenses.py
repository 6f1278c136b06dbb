"""Lenses refined in service: how near they come, how honest that is, what bounds it; nobody gets it unasked."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from camrig import fuse
from camrig.geometry.lens import BrownLens
from camrig.geometry.pose import perturb
from camrig.locate import AS_CALIBRATED, joint
from camrig.locate.learn_lenses import BOUND_SIGMAS
from camrig.locate.lenses import LEAST_SHARE
from camrig.locate.standing import MEMORY_S, aged
from camrig.messages import Level
from tests.driven_floor import learnt, standing, true_errors
from tests.watched_floor import LENS, LENS_SIGMA, SIZE_PX, Errors, Floor

WRONG = Errors(math.radians(0.2), lenses=True)
TURNED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])


def floor_of(seed: int, cameras: int = 4, bodies: int = 6, anchors: bool = True) -> Floor:
    return Floor(seed, cameras, bodies, anchors, errors=WRONG, refine_lenses=True)


def test_what_a_calibration_left_wrong_is_found_and_its_covariance_tells_how_well() -> None:
    before, after, nees = [], [], []
    for seed in range(2):
        floor = floor_of(seed)
        lenses, _ = learnt(floor, 25.0, 1.0)
        for name, error in true_errors(floor).items():
            off = lenses.refined[name].mean - error
            before.append(np.square(error / LENS_SIGMA))
            after.append(np.square(off / LENS_SIGMA))
            nees.append(float(off @ np.linalg.solve(lenses.refined[name].covariance, off)))
    assert np.mean(after) < 0.25 * np.mean(before)
    assert 1.0 < np.mean(nees) < 6.0  # 4 expected


def test_bodies_are_placed_better_by_it_without_an_anchor_in_the_room() -> None:
    before, after, nees = [], [], []
    for seed in range(2):
        floor = Floor(20 + seed, 4, 8, errors=Errors(lenses=True), refine_lenses=True)
        lenses, _ = learnt(floor, 25.0, 1.0)
        before += standing(floor, AS_CALIBRATED)[0]
        found_m, found_nees = standing(floor, lenses)
        after += found_m
        nees += found_nees
    assert np.mean(after) < 0.8 * np.mean(before)
    assert np.mean(nees) < 5.0


def test_heads_that_keep_still_point_better_by_it() -> None:
    """Where lenses are refined, what that shows of the heads' angles is believed too; not once a head has moved."""
    off_m: dict[str, list[float]] = {"calibrated": [], "learnt": []}
    nees, alike = [], []
    for seed in range(3):
        floor = Floor(40 + seed, 3, 3, errors=WRONG, refine_lenses=True)
        lenses, _ = learnt(floor, 25.0, 1.0)
        off_m["calibrated"] += standing(floor, AS_CALIBRATED)[0]
        found_m, found_nees = standing(floor, lenses)
        off_m["learnt"] += found_m
        nees += found_nees
        carried = [view.carried for view in floor.views() if view.carried]
        moved = [replace(pose, T_world_camera=perturb(pose.T_world_camera, TURNED)) for pose in carried]
        alike += [lenses.pose(pose, floor.rig) is pose for pose in moved]
    assert np.mean(off_m["learnt"]) < 0.8 * np.mean(off_m["calibrated"])
    assert np.mean(nees) < 6.0
    assert len(alike) == 9
    assert all(alike)


def test_nothing_is_learnt_unasked() -> None:
    floor = Floor(3, 3, 4, True, errors=WRONG)
    assert learnt(floor, 3.0, 1.0) == (AS_CALIBRATED, [])


def test_a_camera_that_does_not_ask_stays_as_calibrated() -> None:
    floor = floor_of(3)
    cameras = {name: replace(camera, refine_lens=name == "c0") for name, camera in floor.rig.cameras.items()}
    floor.rig = replace(floor.rig, cameras=cameras)
    lenses, _ = learnt(floor, 3.0, 1.0)
    assert set(lenses.refined) == {"c0"}


def test_what_stands_still_is_no_news() -> None:
    floor = floor_of(4)
    motions = fuse.motions(fuse.Tracks(), floor.rig, 1.0)
    first = joint(floor.views(), (), motions, floor.rig).lenses
    again = joint(floor.views(), (), motions, floor.rig, first or AS_CALIBRATED).lenses
    assert first is not None
    assert again is first


def test_evidence_fades_and_some_doubt_always_stays() -> None:
    floor = floor_of(5)
    lenses, _ = learnt(floor, 20.0, 1.0)
    assert lenses.standing is not None
    later = aged(lenses.standing, floor.rig, lenses.standing.stamp_s + 10.0 * MEMORY_S)
    for k, known in enumerate(lenses.refined.values()):
        assert (np.diag(known.covariance) > np.square(LEAST_SHARE * np.asarray(LENS_SIGMA))).all()
        mean, covariance = later.lens(k)
        assert np.abs(mean).max() < 1e-3 * np.abs(known.mean).max()
        assert np.diag(covariance) == pytest.approx(np.square(LENS_SIGMA), rel=1e-3)


def test_a_lens_far_from_its_calibration_is_held_at_the_bound_and_told_of() -> None:
    floor = Floor(6, 3, 6, anchors=True, refine_lenses=True)
    far = (827.7 * (1.0 + 10.0 * LENS_SIGMA[0]), 827.9 * (1.0 + 10.0 * LENS_SIGMA[0]))
    floor.true_lenses["c0"] = BrownLens(SIZE_PX, far, LENS.centre_px, LENS.distortion[:5])
    lenses, said = learnt(floor, 30.0, 1.0)
    assert lenses.refined["c0"].mean[0] == pytest.approx(BOUND_SIGMAS * LENS_SIGMA[0])
    warnings = [note for note in said if note.level is Level.WARNING]
    assert {note.about for note in warnings} == {"c0"}
    assert len(warnings) <= 3
    assert "calibrate it anew" in warnings[0].text


def test_what_is_learnt_is_told_in_few_words() -> None:
    _, said = learnt(floor_of(7), 30.0, 1.0)
    assert 1 <= len(said) < 30
    assert said[0].text.startswith("lens refined by f ")
    assert said[0].text.endswith("px off")


@pytest.mark.parametrize("turns", [False, True], ids=["at rest", "turning"])
def test_heads_that_point_wrong_bend_no_lens(turns: bool) -> None:
    """The calibrations are right, and every head points 0.2 deg wrong, newly so or not after each turn."""
    floor = Floor(9, 3, 6, False, errors=Errors(math.radians(0.2)), refine_lenses=True)
    lenses, _ = learnt(floor, 25.0, 1.0, turns_s=5.0 if turns else math.inf)
    for known in lenses.refined.values():
        assert float(known.mean @ np.linalg.solve(known.covariance, known.mean)) < float(chi2.ppf(0.999, 4))


def test_a_knocked_camera_is_no_bent_lens() -> None:
    floor = floor_of(10)
    lenses, _ = learnt(floor, 15.0, 1.0)
    floor.true_poses["c0"] = perturb(floor.true_poses["c0"], np.array([0.0, 0.0, 0.0, 0.03, 0.0, 0.02]))
    after, _ = learnt(floor, 15.0, 1.0, known=lenses)
    error = true_errors(floor)["c0"]
    off = after.refined["c0"].mean - error
    assert float(off @ np.linalg.solve(after.refined["c0"].covariance, off)) < float(chi2.ppf(0.999, 4))
