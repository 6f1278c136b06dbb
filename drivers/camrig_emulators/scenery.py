"""What stands and moves in the emulated room: robots with their tags, anchors, boxes; where each is at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import apply
from camrig.rig import Body, Box, Rig, TagKey
from camrig_emulators.robots import Motion, poses
from camrig_emulators.tag_pictures import black_cells, tag_cells

_BODY_GREY = 62
_BOX_GREY = 84
_BODY_RIM_M = 0.03
_MIN_BODY_HEIGHT_M = 0.01
_UNIT_CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """A printed tag: ``size_m`` is the side of its black square, ``side_m`` that of the plate, quiet zone included."""

    key: TagKey
    size_m: float
    side_m: float
    T_world_tag: Transform


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """One opaque thing: a box of one grey with eight ``corners_m`` (8, 3), or none, and the plates on it."""

    corners_m: Array | None
    grey: int
    plates: tuple[Plate, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _BodyShape:
    """A body in its own frame: the corners of its chassis, and its plates (``T_world_tag`` is T_body_tag here)."""

    corners_m: Array | None
    plates: tuple[Plate, ...]


class Scenery:
    """The room of a rig, its targets moving as planned; pure, so any thread may ask for any time."""

    def __init__(self, rig: Rig, motions: Mapping[str, Motion]) -> None:
        """Build the room; raises InputError for a tag that cannot be drawn."""
        self.anchors = tuple(
            Thing(None, 0, (_plate(anchor.key, anchor.size_m, anchor.T_world_tag),)) for anchor in rig.anchors
        )
        self.boxes = tuple(Thing(_box_corners(box), _BOX_GREY, ()) for box in rig.space.keep_out_m)
        self.box_limits_m = rig.space.keep_out_m
        self.floor_m = rig.space.floor_m
        self._motions = dict(motions)
        self._shapes = {name: _body_shape(body) for name, body in rig.targets.items()}

    def robots(self, time_s: float) -> tuple[Thing, ...]:
        """Return every target as it stands at one world time."""
        return self.posed(self.poses(time_s))

    def posed(self, places: Mapping[str, Transform]) -> tuple[Thing, ...]:
        """Return targets where they are said to stand, ``T_world_body`` by id."""
        return tuple(_posed(self._shapes[name], T) for name, T in places.items())

    def poses(self, time_s: float) -> dict[str, Transform]:
        """Return ``T_world_body`` of every target at one world time: the truth."""
        return poses(self._motions, time_s)


def _plate(key: TagKey, size_m: float, T_world_tag: Transform) -> Plate:
    cells = tag_cells(key).shape[0]
    return Plate(key, size_m, size_m * cells / black_cells(key.family), T_world_tag)


def _body_shape(body: Body) -> _BodyShape:
    """Build a chassis that carries the tags: a rim wider than all of them and as high as the highest."""
    plates = tuple(_plate(tag.key, tag.size_m, tag.T_body_tag) for tag in body.tags)
    if not plates:
        return _BodyShape(None, ())
    half = max(float(np.abs(plate.T_world_tag[:2, 3]).max()) + plate.side_m / 2.0 for plate in plates) + _BODY_RIM_M
    height_m = max(float(plate.T_world_tag[2, 3]) for plate in plates) - 0.001
    low, high = np.array([-half, -half, 0.0]), np.array([half, half, max(height_m, 0.0)])
    if height_m < _MIN_BODY_HEIGHT_M:
        return _BodyShape(None, plates)
    return _BodyShape(low + _UNIT_CORNERS * (high - low), plates)


def _posed(shape: _BodyShape, T_world_body: Transform) -> Thing:
    plates = tuple(
        Plate(plate.key, plate.size_m, plate.side_m, T_world_body @ plate.T_world_tag) for plate in shape.plates
    )
    return Thing(None if shape.corners_m is None else apply(T_world_body, shape.corners_m), _BODY_GREY, plates)


def _box_corners(box: Box) -> Array:
    low, high = np.asarray(box)
    return np.asarray(low + _UNIT_CORNERS * (high - low))
