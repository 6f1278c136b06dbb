"""A camera that is not where its calibration says: told from a moved anchor, placed all the same, and reported."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.locate import Drift, Histories, Located, locate
from camrig.messages import AxisReading, TagDetections
from camrig.pipeline import begin
from camrig.pipeline.watch import camera_events, with_corrections
from tests.anchored_cameras import (
    FIXED_CAMERA,
    HEAD_CAMERA,
    KINEMATICS,
    ON_FLOOR,
    PAN,
    RIG,
    T_MOUNT,
    TILT,
    TRUE_ON_HEAD,
    anchor,
    read,
    seen,
)


def knocked(turn_deg: float, shift_m: float = 0.0) -> Array:
    """Where the wall's camera is after a knock."""
    return pose.perturb(TRUE_ON_HEAD, np.array([shift_m, 0.0, 0.0, 0.0, math.radians(turn_deg), 0.0]))


def placed(picture: TagDetections) -> Located:
    return locate(picture, Histories(), RIG, {})


def test_a_knocked_camera_is_placed_by_the_anchors_that_agree_and_the_operator_told() -> None:
    T = knocked(2.0, 0.03)
    found = placed(seen(ON_FLOOR[:2], T, FIXED_CAMERA))
    assert found.camera_pose is not None
    assert found.camera_pose.T_world_camera == pytest.approx(T, abs=1e-4)
    (note,) = found.notes
    assert note.about == "wall"
    assert "placed by them alone" in note.text
    assert found.view is not None
    assert found.view.carried is None  # nothing pulls it back
    assert len(found.view.anchors) == 2


def test_a_head_that_lost_its_zero_is_found_out() -> None:
    found = locate(seen(ON_FLOOR, TRUE_ON_HEAD, HEAD_CAMERA), read(PAN + 0.2, TILT), RIG, {})
    assert found.camera_pose is not None
    assert found.camera_pose.T_world_camera == pytest.approx(TRUE_ON_HEAD, abs=1e-4)
    assert [note.about for note in found.notes] == ["north"]


@pytest.mark.parametrize("moved", [1, 2])
def test_anchors_that_are_moved_one_by_one_are_blamed_and_not_the_camera(moved: int) -> None:
    apart = (anchor(100, 1.95, 2.3), anchor(101, 1.2, 2.75), anchor(102, 2.2, 1.7))
    found = placed(seen((*apart[:moved], *ON_FLOOR[moved:]), TRUE_ON_HEAD, FIXED_CAMERA))
    assert found.camera_pose is not None
    assert np.abs(pose.difference(TRUE_ON_HEAD, found.camera_pose.T_world_camera)).max() < 3e-3
    assert [note.about for note in found.notes] == [f"tag36h11:{100 + k}" for k in range(moved)]


def test_one_anchor_alone_is_never_believed_against_the_calibration() -> None:
    found = placed(seen((anchor(100, 2.1, 2.2),), TRUE_ON_HEAD, FIXED_CAMERA))
    assert [note.about for note in found.notes] == ["tag36h11:100"]


def told(pictures: Iterable[tuple[TagDetections, Histories]], seconds: float) -> tuple[str, ...]:
    """What an operator is told of cameras that were watched so long."""
    drifts: dict[str, Drift] = {}
    for picture, histories in pictures:
        found = locate(picture, histories, RIG, {})
        poses = {} if found.camera_pose is None else {found.camera_pose.camera_id: found.camera_pose}
        drifts = with_corrections(drifts, [found], poses, RIG)
    return tuple(event.text for event in camera_events(replace(begin(0.0), drifts=drifts), seconds))


def watched(turn_deg: float, seconds: float, hidden_s: float = 0.0) -> tuple[str, ...]:
    """What is told of the wall's camera, knocked; then for a time it sees no anchor."""
    rng = np.random.default_rng(1)
    stamps = [k / 5.0 for k in range(int(5.0 * (seconds + hidden_s)))]
    shown = ((ON_FLOOR if stamp_s < seconds else (), stamp_s) for stamp_s in stamps)
    pictures = ((seen(tags, knocked(turn_deg), FIXED_CAMERA, rng, stamp_s), Histories()) for tags, stamp_s in shown)
    return told(pictures, seconds)


def test_a_small_drift_is_an_alarm_after_a_while_and_what_the_calibration_allows_is_none() -> None:
    assert watched(0.05, 30.0) == ()
    assert watched(0.25, 15.0) == ()  # not yet
    (text,) = watched(0.25, 30.0)
    assert "is not where its calibration and readings put it" in text


def test_an_alarm_stays_while_nothing_can_be_seen_of_the_cause() -> None:
    assert len(watched(0.25, 30.0, hidden_s=30.0)) == 1


def test_a_bias_that_a_head_may_have_is_none_wherever_it_turns() -> None:
    """A tilt that is 1.5 sigma wrong rolls the camera elsewhere in the world after each turn."""
    rng, pictures = np.random.default_rng(2), []
    for k in range(400):
        stamp_s = 1.0 + k / 5.0
        pan_rad = 1.2 if (k // 50) % 2 else 0.5
        T = KINEMATICS.T_world_camera(pan_rad, TILT + 0.0045, T_MOUNT)
        moved = Histories()
        for at_s in (stamp_s - 0.1, stamp_s + 0.1):
            moved = moved.with_reading(AxisReading("h", "pan", pan_rad, at_s, 1e-4, 0.0))
            moved = moved.with_reading(AxisReading("h", "tilt", TILT, at_s, 1e-4, 0.0))
        pictures.append((seen(ON_FLOOR[:2], T, HEAD_CAMERA, rng, stamp_s), moved))
    for end in range(120, 401, 40):
        assert told(pictures[:end], 100.0) == ()
