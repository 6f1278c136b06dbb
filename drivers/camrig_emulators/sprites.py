"""Scenery as one camera sees it at one instant: what lies where in the picture, in the order to paint it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.geometry.pose import apply, invert
from camrig.rig import Box
from camrig_emulators.lens_rays import FloatImage, LensRays
from camrig_emulators.scenery import Plate, Thing
from camrig_emulators.tag_pictures import tag_cells, tag_texture

Rect = tuple[int, int, int, int]
"""Columns and rows of the picture: x0, y0, x1, y1; the last ones are outside."""

_MARGIN_PX = 5
_OUTLINE = np.array(
    [[x, y, 0.0] for t in (-0.5, -0.25, 0.0, 0.25) for x, y in ((t, -0.5), (0.5, t), (-t, 0.5), (-0.5, -t))]
)
_TEXELS_PER_CELL = (4, 8, 16, 32, 64)
_MIN_SIDE_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class PlateSprite:
    """A plate in the picture: its side in pixels, and the (3, 3) map from ideal rays to plate sides (0 to 1)."""

    plate: Plate
    rect: Rect
    side_px: float
    ray_to_plate: Array


@dataclass(frozen=True, slots=True, eq=False)
class Sprite:
    """A thing in the picture: the outline (n, 2) of its box, if it has one, and the plates that face the camera."""

    rect: Rect
    outline_px: Array | None
    grey: int
    plates: tuple[PlateSprite, ...]


def sprites(things: Sequence[Thing], T_world_camera: Transform, rays: LensRays) -> list[Sprite]:
    """Return what of ``things`` is in the picture, in their order."""
    if not things:
        return []
    parts = [_outline_points(thing) for thing in things]
    T_camera_world = invert(T_world_camera)
    pixels = rays.project(apply(T_camera_world, np.concatenate(parts)))
    ends = np.cumsum([len(part) for part in parts])
    found = [
        _sprite(thing, pixels[end - len(part) : end], T_camera_world, rays)
        for thing, part, end in zip(things, parts, ends, strict=True)
    ]
    return [sprite for sprite in found if sprite is not None]


def paint(target: GreyImage, rect: Rect, sprite: Sprite, rays: LensRays, supersampling: int) -> None:
    """Paint a sprite over ``target``, the part ``rect`` of the picture at ``supersampling`` samples a pixel side."""
    if sprite.outline_px is not None:
        corner = (sprite.outline_px - np.array(rect[:2]) + 0.5) * supersampling - 0.5
        cv2.fillConvexPoly(target, np.round(corner * 16.0).astype(np.int32), sprite.grey, cv2.LINE_8, 4)
    for plate in sprite.plates:
        part = _overlap(plate.rect, rect)
        if part is not None:
            _paint_plate(target, rect, part, plate, rays, supersampling)


def painting_order(
    anchors: Sequence[Thing], robots: Sequence[Thing], boxes: Sequence[Thing], limits_m: Sequence[Box], eye_m: Array
) -> list[Thing]:
    """Return the things so that whatever hides another comes after it, as seen from ``eye_m`` (3,).

    Anchors lie behind robots, near robots before far ones; a box comes right after the last thing that it hides a
    corner of. Exact while robots keep apart and boxes are convex.
    """
    order = [*anchors, *sorted(robots, key=lambda robot: -_distance(robot, eye_m))]
    far_first = sorted(zip(boxes, limits_m, strict=True), key=lambda pair: -_distance(pair[0], eye_m))
    for thing, limits in far_first:
        hidden = [index for index, other in enumerate(order) if _hides(limits, eye_m, _outline_points(other))]
        order.insert(hidden[-1] + 1 if hidden else 0, thing)
    return order


def _distance(thing: Thing, eye_m: Array) -> float:
    return float(np.linalg.norm(_outline_points(thing).mean(axis=0) - eye_m))


def _hides(limits: Box, eye_m: Array, points: Array) -> bool:
    """Say whether the box lies between the eye and any of (n, 3) points: the slab test on each line of sight."""
    low, high = np.asarray(limits)
    direction = points - eye_m
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    first, second = (low - eye_m) / direction, (high - eye_m) / direction
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return bool(np.any((enter < leave) & (leave > 0.0) & (enter < 1.0 - 1e-6)))


def _outline_points(thing: Thing) -> Array:
    """Return the box's corners, then sixteen points round each plate, (n, 3) in the world."""
    plates = [apply(plate.T_world_tag, _OUTLINE * plate.side_m) for plate in thing.plates]
    return np.concatenate([*([] if thing.corners_m is None else [thing.corners_m]), *plates])


def _sprite(thing: Thing, pixels: Array, T_camera_world: Transform, rays: LensRays) -> Sprite | None:
    corners = 0 if thing.corners_m is None else len(thing.corners_m)
    rect = _rect(pixels, rays.size_px)
    if rect is None:
        return None
    outline = _hull(pixels[:corners])
    outlines = pixels[corners:].reshape(-1, len(_OUTLINE), 2)
    plates = [
        _plate_sprite(plate, around, T_camera_world, rays) for plate, around in zip(thing.plates, outlines, strict=True)
    ]
    facing = tuple(plate for plate in plates if plate is not None)
    return Sprite(rect, outline, thing.grey, facing) if facing or outline is not None else None


def _plate_sprite(plate: Plate, pixels: Array, T_camera_world: Transform, rays: LensRays) -> PlateSprite | None:
    """Return None for a plate that is out of the picture, turned away or too small to matter."""
    rect = _rect(pixels, rays.size_px)
    T_camera_tag = T_camera_world @ plate.T_world_tag
    faces = float(T_camera_tag[:3, 2] @ T_camera_tag[:3, 3]) < 0.0
    if rect is None or not faces:
        return None
    side_px = float(np.nanmax(np.ptp(pixels[np.isfinite(pixels[:, 0])], axis=0)))
    if side_px < _MIN_SIDE_PX:
        return None
    to_sides = np.array([[1.0 / plate.side_m, 0.0, 0.5], [0.0, -1.0 / plate.side_m, 0.5], [0.0, 0.0, 1.0]])
    ray_to_plate = to_sides @ np.linalg.inv(T_camera_tag[:3, [0, 1, 3]])
    return PlateSprite(plate, rect, side_px, ray_to_plate)


def _paint_plate(
    target: GreyImage, rect: Rect, part: Rect, sprite: PlateSprite, rays: LensRays, supersampling: int
) -> None:
    """Sample the plate's texture where the rays of the samples meet its plane."""
    texture = _texture(sprite, supersampling)
    side = texture.shape[0]
    # Texel centres lie half a texel inside, OpenCV's coordinates count from the first centre.
    to_texels = np.array([[side, 0.0, -0.5], [0.0, side, -0.5], [0.0, 0.0, 1.0]])
    x0, y0, x1, y1 = part
    ideal = rays.crop(x0 - 1, y0 - 1, x1 + 1, y1 + 1)
    at_pixels = np.asarray(cv2.perspectiveTransform(ideal, to_texels @ sprite.ray_to_plate), dtype=np.float32)
    at_samples = _finer(at_pixels, supersampling)
    top, left = (y0 - rect[1]) * supersampling, (x0 - rect[0]) * supersampling
    bottom, right = top + (y1 - y0) * supersampling, left + (x1 - x0) * supersampling
    patch = target[top:bottom, left:right]
    # OpenCV takes None beside a two-channel map (not an empty array); its type stubs forget that.
    cv2.remap(texture, at_samples, None, cv2.INTER_LINEAR, patch, cv2.BORDER_TRANSPARENT)  # type: ignore[call-overload]


def _finer(at_pixels: FloatImage, supersampling: int) -> FloatImage:
    """Interpolate a map of pixels, one pixel wider on each side than wanted, at the samples of the inner pixels."""
    fine = cv2.resize(at_pixels, None, fx=supersampling, fy=supersampling, interpolation=cv2.INTER_LINEAR)
    inner = fine[supersampling:-supersampling, supersampling:-supersampling]
    return np.ascontiguousarray(inner, dtype=np.float32)


def _texture(sprite: PlateSprite, supersampling: int) -> GreyImage:
    """Return the coarsest texture whose texels are no larger than a sample: linear interpolation then smooths right."""
    wanted = sprite.side_px * supersampling / tag_cells(sprite.plate.key).shape[0]
    texels = next((count for count in _TEXELS_PER_CELL if count >= wanted), _TEXELS_PER_CELL[-1])
    return tag_texture(sprite.plate.key, texels)


def _hull(pixels: Array) -> Array | None:
    seen = pixels[np.isfinite(pixels[:, 0])]
    if len(seen) < 3:
        return None
    return np.asarray(cv2.convexHull(seen.astype(np.float32)), dtype=float).reshape(-1, 2)


def _rect(pixels: Array, size_px: tuple[int, int]) -> Rect | None:
    """Return the rectangle of the picture round (n, 2) pixels with a margin; None where there is none."""
    seen = pixels[np.isfinite(pixels[:, 0])]
    if not len(seen):
        return None
    low = np.floor(seen.min(axis=0)).astype(int) - _MARGIN_PX
    high = np.ceil(seen.max(axis=0)).astype(int) + _MARGIN_PX + 1
    return _overlap((int(low[0]), int(low[1]), int(high[0]), int(high[1])), (0, 0, *size_px))


def _overlap(a: Rect, b: Rect) -> Rect | None:
    x0, y0, x1, y1 = max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
