"""A plan as a picture: the room from above, what each camera covers of the floor, targets coloured by who sees them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.messages import RigPlan
from camrig.optimise.places import camera_poses, vector_of
from camrig.optimise.scene import DronePlace, Place, Scene, SceneCamera

_PX_PER_M = 160.0
_BORDER_M = 0.6
_EDGE_POINTS = 40
_FARTHEST_M = 12.0
_COLOURS = ((200, 120, 30), (40, 140, 40), (40, 60, 210), (170, 50, 170), (20, 150, 200), (130, 130, 20), (90, 90, 90))
_RED, _BLACK, _GREY = (0, 0, 220), (0, 0, 0), (160, 160, 160)


def write_plan_map(path: Path, scene: Scene, plan: RigPlan) -> None:
    """Draw the plan to a picture file; raises InputError where it cannot be written."""
    try:
        encoded, data = cv2.imencode(path.suffix or ".png", draw_plan_map(scene, plan))
        if not encoded:
            raise InputError(f"{path}: pictures are written as .png or .jpg")
        path.write_bytes(data.tobytes())
    except cv2.error as error:
        raise InputError(f"{path}: pictures are written as .png or .jpg") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def draw_plan_map(scene: Scene, plan: RigPlan) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return the (height, width, 3) BGR map: north up, footprints on the plane z = 0, quality in mm/px."""
    poses = {camera.id: _pose(camera, plan) for camera in scene.cameras}
    low, high = _extent(scene, poses)
    size = np.ceil((high - low) * _PX_PER_M).astype(int)
    canvas = np.full((int(size[1]), int(size[0]), 3), 255, dtype=np.uint8)

    def pixel(points_m: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
        xy = np.atleast_2d(points_m)[:, :2] - low
        return np.column_stack([xy[:, 0] * _PX_PER_M, size[1] - xy[:, 1] * _PX_PER_M]).round().astype(np.int32)

    for i, camera in enumerate(scene.cameras):
        footprint = pixel(_footprint(camera, *poses[camera.id]))
        tinted = canvas.copy()
        cv2.fillPoly(tinted, [footprint], _COLOURS[i % len(_COLOURS)])
        canvas = cv2.addWeighted(tinted, 0.15, canvas, 0.85, 0.0).astype(np.uint8)
        cv2.polylines(canvas, [footprint], isClosed=True, color=_COLOURS[i % len(_COLOURS)], lineType=cv2.LINE_AA)
    for corner_low, corner_high in scene.keep_out_m:
        a, b = pixel(np.array([corner_low, corner_high]))
        cv2.rectangle(canvas, a.tolist(), b.tolist(), _GREY, -1)
    for i, camera in enumerate(scene.cameras):
        (at,) = pixel(poses[camera.id][1])
        cv2.circle(canvas, at.tolist(), 7, _COLOURS[i % len(_COLOURS)], -1, cv2.LINE_AA)
        _label(canvas, camera.id, at.tolist())
    for target in scene.targets:
        (at,) = pixel(np.array(target.position_m))
        quality_m = plan.targets[target.id].quality_m
        cv2.drawMarker(canvas, at.tolist(), _RED if quality_m is None else _BLACK, cv2.MARKER_CROSS, 12, 2)
        _label(canvas, target.id if quality_m is None else f"{target.id} {quality_m * 1e3:.2f}", at.tolist())
    return canvas


def _pose(camera: SceneCamera, plan: RigPlan) -> tuple[Array, Array]:
    vector = vector_of(camera.place, plan.aims.get(camera.id))
    if vector is None:
        raise InputError(f"the plan has no aim for camera {camera.id}")
    R, position = camera_poses(camera.place, vector[None])
    return R[0], position[0]


def _extent(scene: Scene, poses: dict[str, tuple[Array, Array]]) -> tuple[Array, Array]:
    points = [position[:2] for _, position in poses.values()]
    points += [np.array(target.position_m[:2]) for target in scene.targets]
    points += [np.array(corner[:2]) for camera in scene.cameras for corner in _corners(camera.place)]
    return np.min(points, axis=0) - _BORDER_M, np.max(points, axis=0) + _BORDER_M


def _corners(place: Place) -> list[tuple[float, float, float]]:
    return list(place.box_m) if isinstance(place, DronePlace) else []


def _footprint(camera: SceneCamera, R_world_camera: Array, position: Array) -> Array:
    """Return the (n, 2) outline of what the image covers of the plane z = 0, cut off far away."""
    (width, height), share = camera.lens.size_px, np.linspace(0.0, 1.0, _EDGE_POINTS, endpoint=False)
    edges = [
        np.column_stack([share * width, np.zeros(_EDGE_POINTS)]),
        np.column_stack([np.full(_EDGE_POINTS, width), share * height]),
        np.column_stack([(1.0 - share) * width, np.full(_EDGE_POINTS, height)]),
        np.column_stack([np.zeros(_EDGE_POINTS), (1.0 - share) * height]),
    ]
    ideal = camera.lens.unproject(np.concatenate(edges))
    ideal = ideal[~np.isnan(ideal).any(axis=1)]
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ R_world_camera.T
    reach = position[2] / np.maximum(-rays[:, 2], position[2] / _FARTHEST_M)
    return np.asarray(position[:2] + rays[:, :2] * np.minimum(reach, _FARTHEST_M)[:, None])


def _label(canvas: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], text: str, at: list[int]) -> None:
    place = (at[0] + 9, at[1] - 6)
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, _BLACK, 1, cv2.LINE_AA)
