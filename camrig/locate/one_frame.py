"""From the tags of one frame to sightings of targets in the world: the whole of ``locate`` on one screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import invert
from camrig.locate.anchors import correct, from_anchors_alone
from camrig.locate.body_pose import hovering, navigates_by
from camrig.locate.camera_pose import camera_pose
from camrig.locate.head_angles import head_angles
from camrig.locate.history import Histories
from camrig.locate.sightings import seen_bodies, solve
from camrig.locate.tags import SeenTag, owners, undistorted, without_repeats
from camrig.locate.views import View
from camrig.messages import AxisReading, CameraPose, Event, Level, Sighting, TagDetection, TagDetections
from camrig.rig import CameraSpec, DroneMount, HeadMount, Rig

_ELSEWHERE = (
    "all anchors in view agree with each other and not with where its calibration and readings put it: "
    "placed by them alone; see to its mount, and calibrate it"
)


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What one frame tells.

    ``camera_pose`` and ``view``, all of it to be estimated together with other cameras' frames, are None where nothing
    tells where the camera was, and then there are no sightings. ``unlisted`` tags are in the picture, not in the rig:
    reported, never fused. ``notes`` repeat in every frame while their cause lasts, with the same text. ``head_angles``
    are what the anchors in view say of the camera's head, beside its own readings. ``carried`` is where calibration
    and readings alone put the camera, right or not.
    """

    camera_pose: CameraPose | None
    view: View | None = None
    sightings: tuple[Sighting, ...] = ()
    unlisted: tuple[TagDetection, ...] = ()
    notes: tuple[Event, ...] = ()
    head_angles: tuple[AxisReading, ...] = ()
    carried: CameraPose | None = None


def locate(detections: TagDetections, histories: Histories, rig: Rig, priors: Mapping[str, Transform]) -> Located:
    """Find the camera, correct it by the anchors in view, and place every listed target that it sees.

    ``priors`` are predicted ``T_world_body`` at the frame's stamp by target id, where known; they only choose between
    solutions that the picture leaves open.
    """
    camera = rig.cameras[detections.camera_id]
    known = owners(rig)
    unlisted = tuple(tag for tag in detections.tags if tag.key not in known)
    if detections.size_px != camera.lens.size_px:
        text = f"pictures are {_size(detections.size_px)}, its lens is for {_size(camera.lens.size_px)}: not used"
        return Located(None, None, (), unlisted, (_warning(detections, camera.id, text),))
    tags = undistorted(camera.lens, [(tag, known[tag.key]) for tag in detections.tags if tag.key in known])
    carried = camera_pose(camera, rig, histories, detections.stamp_s)
    anchors = [tag for tag in tags if tag.owner.target_id is None]
    made_of_anchors = navigates_by(camera.id, rig) is not None  # its telemetry: one or the other, then
    placed = _with_anchors(detections, camera, None if made_of_anchors else carried, anchors)
    found, believed, notes = placed.pose, placed.carried, placed.notes
    if made_of_anchors and found is None:
        found = believed = carried
    if found is None:
        return Located(None, None, (), unlisted, notes)
    own = [tag for tag in tags if tag.owner.target_id is not None]
    single, repeated = without_repeats(own, lambda tag: _expected_px(camera, found, tag, priors))
    bodies = seen_bodies(single, rig.targets, priors)
    sightings, misfits = solve(bodies, found, camera.lens)
    notes += tuple(_warning(detections, str(key), f"more than one in the picture of {camera.id}") for key in repeated)
    notes += tuple(
        _warning(detections, name, f"{camera.id} sees tags that do not fit its size, place or upright stand: not used")
        for name in misfits
    )
    fitting = tuple(body for body in bodies if body.body.id not in misfits)
    view = View(camera.id, detections.stamp_s, believed, found, placed.anchors, fitting, sightings)
    return Located(found, view, sightings, unlisted, notes, _head_angles(camera, rig, believed, found), carried)


def _head_angles(
    camera: CameraSpec, rig: Rig, carried: CameraPose | None, found: CameraPose
) -> tuple[AxisReading, ...]:
    match camera.mount:
        case HeadMount(head=name) if found is not carried:
            return head_angles(rig.heads[name], camera.mount, carried, found)
    return ()


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """The camera's pose after the anchors in view, what it was carried from, the anchors that agree with it, and what
    is wrong with others.
    """

    pose: CameraPose | None
    carried: CameraPose | None
    anchors: tuple[SeenTag, ...]
    notes: tuple[Event, ...]


def _with_anchors(
    detections: TagDetections, camera: CameraSpec, carried: CameraPose | None, anchors: Sequence[SeenTag]
) -> _Placed:
    """Correct the camera by the anchors in view. Where two and more of them agree with each other and none with its
    calibration and readings, it is these that are wrong: it is placed by the anchors alone.
    """
    single, repeated = without_repeats(anchors, lambda tag: _expected_px(camera, carried, tag, {}))
    notes = [_warning(detections, str(key), f"anchor more than once in the picture of {camera.id}") for key in repeated]
    if not single:
        return _Placed(carried, carried, (), tuple(notes))
    if carried is None:
        belief = hovering(camera.mount) if isinstance(camera.mount, DroneMount) else None
        found = from_anchors_alone(camera.id, detections.stamp_s, single, belief)
    else:
        found = correct(carried, single)
        if len(found.misplaced) == len(single) > 1:
            alone = from_anchors_alone(camera.id, detections.stamp_s, single)
            if alone.pose is not None and not alone.misplaced:
                notes.append(_warning(detections, camera.id, _ELSEWHERE))
                found, carried = alone, None
    notes += [
        _warning(detections, str(key), f"anchor is not where {camera.id} should see it: not used")
        for key in found.misplaced
    ]
    if found.undecided:
        notes.append(
            _warning(detections, camera.id, "the anchors in view leave two camera poses to choose from: frame not used")
        )
    used = tuple(tag for tag in single if tag.key not in found.misplaced)
    return _Placed(found.pose, carried, used, tuple(notes))


def _expected_px(
    camera: CameraSpec, pose: CameraPose | None, tag: SeenTag, priors: Mapping[str, Transform]
) -> Array | None:
    """Return the (2,) pixel where a tag's centre should be; None where camera or body is not known."""
    name = tag.owner.target_id
    T_world_owner = np.eye(4) if name is None else priors.get(name)
    if pose is None or T_world_owner is None:
        return None
    T_camera_tag = invert(pose.T_world_camera) @ T_world_owner @ tag.owner.T_owner_tag
    return camera.lens.project(T_camera_tag[:3, 3])


def _warning(detections: TagDetections, about: str, text: str) -> Event:
    return Event(detections.stamp_s, Level.WARNING, about, text)


def _size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
