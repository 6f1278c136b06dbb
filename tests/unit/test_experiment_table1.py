"""The rooms of table 1, what is kept of it, who does its jobs, and the figures that its trials make."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from camrig.errors import InputError
from camrig.experiments.configurations import planned
from camrig.experiments.estimators import ESTIMATORS
from camrig.experiments.kept import Kept
from camrig.experiments.rooms import ANCHORS_M, Wrong, draw_room
from camrig.experiments.scenes import FLOOR_M, LAB_LENS, Place
from camrig.experiments.statistics import Ranged, mean_of_groups, percentile_of_groups, ratio_of_means
from camrig.experiments.table1 import Condition, Trial
from camrig.experiments.table1_figures import duels, models, ratio, rows
from camrig.experiments.work import done
from camrig.geometry.pose import difference
from camrig.messages import DroneAim, HeadAim

OFF = Wrong(math.radians(0.1), 0.005, lenses=True)


def test_a_room_keeps_its_bodies_and_errors_whatever_else_is_asked_of_it() -> None:
    place = Place("drone", 5, 20, 3)
    plain, anchored, exact = (
        draw_room(place, OFF, anchors=False),
        draw_room(place, OFF, anchors=True),
        draw_room(place, Wrong(), anchors=True),
    )
    for name, T in plain.bodies.items():
        assert np.array_equal(T, anchored.bodies[name])
        assert np.array_equal(T, exact.bodies[name])
    assert len(anchored.rig.anchors) == len(ANCHORS_M)
    assert not plain.rig.anchors
    for name, errors in plain.errors.items():
        assert np.array_equal(errors.pose, anchored.errors[name].pose)
        assert errors.lens.focal_px == anchored.errors[name].lens.focal_px != LAB_LENS.focal_px
        assert exact.errors[name].lens is LAB_LENS
    places = np.array([T[:2, 3] for T in plain.bodies.values()])
    apart = np.linalg.norm(places[:, None] - np.concatenate([places, ANCHORS_M])[None], axis=2)
    assert np.sort(apart, axis=1)[:, 1].min() >= 0.3
    assert (places > 0.0).all()
    assert (places < FLOOR_M).all()


def test_cameras_are_off_by_what_is_asked_and_no_more() -> None:
    deltas = []
    for seed in range(40):
        room = draw_room(Place("drone", 5, 3, seed), OFF, anchors=False)
        aim = DroneAim((2.0, 1.0, 2.0), 0.4)
        deltas += [difference(room.true_pose(name, aim), room.believed_pose(name, aim)) for name in room.rig.cameras]
    assert np.std(deltas, axis=0)[:3] == pytest.approx(0.005, rel=0.2)
    assert np.std(deltas, axis=0)[3:] == pytest.approx(math.radians(0.1), rel=0.2)
    exact = draw_room(Place("ptz", 2, 3, 0), Wrong(), anchors=False)
    head = HeadAim(0.3, -0.9)
    assert np.array_equal(exact.true_pose("c1", head), exact.believed_pose("c1", head))
    pointing = draw_room(Place("ptz", 2, 3, 0), OFF, anchors=False)
    off = difference(pointing.true_pose("c1", head), pointing.believed_pose("c1", head))
    assert not off[:3].any()
    assert 0.0 < np.linalg.norm(off[3:]) < math.radians(0.5)


def test_held_heads_look_at_the_middle_of_the_room() -> None:
    room = draw_room(Place("ptz", 3, 3, 1), Wrong(), anchors=False)
    plan = planned("hold", room, lambda: 0.0)
    for name in room.rig.cameras:
        T = room.believed_pose(name, plan.aims[name])
        to_middle = np.array([*np.asarray(FLOOR_M) / 2.0, 0.0]) - T[:3, 3]
        assert float(T[:3, 2] @ to_middle / np.linalg.norm(to_middle)) == pytest.approx(1.0)


def test_figures_of_groups_draw_whole_groups() -> None:
    groups = [np.full(10, 1.0), np.full(10, 3.0)]
    found = mean_of_groups(groups)
    assert found is not None
    assert (found.value, found.low, found.high) == (2.0, 1.0, 3.0)
    assert mean_of_groups([np.zeros(0)]) is None
    compared = ratio_of_means([(np.array([1.0, 1.0]), np.array([10.0, 10.0])), (np.zeros(0), np.zeros(0))])
    assert compared is not None
    assert (compared.value, compared.low, compared.high) == pytest.approx((0.1, 0.1, 0.1))
    assert ratio_of_means([]) is None


def test_a_percentile_of_groups_is_that_of_all_values() -> None:
    rng = np.random.default_rng(4)
    values = rng.exponential(size=200)
    found = percentile_of_groups(np.split(values, 20), 95.0)
    assert found is not None
    assert found.value == np.percentile(values, 95.0, method="inverted_cdf")
    assert found.low < found.value < found.high
    assert percentile_of_groups([values], 50.0) == Ranged(*[float(np.percentile(values, 50.0, method="lower"))] * 3)
    assert percentile_of_groups([], 50.0) is None


def test_what_is_kept_is_found_again_even_after_a_kill_while_writing(tmp_path: Path) -> None:
    path = tmp_path / "table1.jsonl"
    first = Kept(path, "table1 of camrig 1")
    first.add("a", [1.5, {"x": [0.1]}])
    first.add("b", [2])
    path.write_text(path.read_text()[:-3])  # "b" was being written
    again = Kept(path, "table1 of camrig 1")
    assert again["a"] == [1.5, {"x": [0.1]}]
    assert "b" not in again
    again.add("b", [3])
    assert Kept(path, "table1 of camrig 1")["b"] == [3]
    with pytest.raises(InputError, match=r"table1 of camrig 1, not of table1 of camrig 2"):
        Kept(path, "table1 of camrig 2")
    path.write_text("a novel\n")
    with pytest.raises(InputError, match="holds no results"):
        Kept(path, "table1 of camrig 1")
    with pytest.raises(InputError, match="cannot be kept here"):
        Kept(tmp_path, "table1 of camrig 1")


def test_jobs_are_done_until_interrupted() -> None:
    assert dict(done(abs, [-1, -2, -3], 1, lambda: 0.0)) == {-1: 1, -2: 2, -3: 3}

    def interrupted() -> float:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(done(abs, [-1, -2], 1, interrupted))


def trial(seed: int, configuration: str, error_mm: float, condition: Condition = "off") -> Trial:
    errors = {name: {"t1": [error_mm / 1e3, 0.0, 0.0]} for name in ESTIMATORS}
    nees = {name: {"t1": 3.0} if name == "joint" else {} for name in ESTIMATORS}
    return Trial("ptz", 3, 2, seed, condition, configuration, {}, 4, 3, {"t1": 0.002}, errors, nees, 0.01)  # type: ignore[arg-type]


def both(seeds: range) -> Iterator[Trial]:
    for seed in seeds:
        yield trial(seed, "camrig-pixel", 1.0 + seed)
        yield trial(seed, "paper-sqp", 10.0 * (1.0 + seed))
        yield trial(seed, "paper-ipopt", 30.0)


def test_figures_count_what_was_missed_and_compare_like_with_like() -> None:
    found = list(both(range(2)))
    row = next(row for row in rows(found) if row.configuration == "camrig-pixel")
    assert (row.scenes, row.coverage, row.detection_rate) == (2, 0.5, 0.75)
    assert row.errors["joint"].mean_mm.value == pytest.approx(1.5)
    assert row.errors["joint"].nees == 3.0
    assert row.errors["mean"].nees is None
    (duel,) = duels(found, "camrig-pixel")
    assert duel.detected is not None
    assert (duel.detected.configuration, duel.estimator) == ("paper-sqp", "joint")
    assert duel.detected.ratio.value == pytest.approx(0.1)
    assert not models(found)
    assert ratio(found, ("camrig-pixel", "joint"), ("hold", "joint")) is None


def test_where_cameras_are_exact_camrig_is_told_so() -> None:
    (duel,) = duels([trial(0, "camrig-pixel", 1.0, "exact"), trial(0, "paper-sqp", 2.0, "exact")], "camrig-pixel")
    assert duel.estimator == "joint exact"
