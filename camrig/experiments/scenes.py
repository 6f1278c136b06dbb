"""Random scenes: the paper's 5 m x 3 m room, and halls of any size; the lab lens, targets on the floor.

Drawn from a seed alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.optimise import DronePlace, HeadPlace, PlannerSettings, PoseSigma, Scene, SceneCamera, SceneTarget

Mode = Literal["ptz", "drone"]


@dataclass(frozen=True, slots=True)
class Place:
    """Which random scene it is."""

    mode: Mode
    cameras: int
    targets: int
    seed: int


PAPER = PlannerSettings()

LAB_LENS = BrownLens(
    size_px=(1280, 800),
    focal_px=(827.678512401081, 827.856142111345),
    centre_px=(640.0, 400.0),
    distortion=(-0.335814019871572, 0.101431758719313, 0.0, 0.0, 0.0),
)
"""The lens of the paper's public repository."""

FLOOR_M = (5.0, 3.0)
HEIGHTS_M = (2.5, 3.0)
FLIGHT_BOX_M = ((0.0, 0.0, 1.0), (5.0, 3.0, 3.0))
PAN_RAD = (-math.pi, math.pi)
TILT_RAD = (math.radians(-90.0), math.radians(-5.0))

_CELL_M = 4.0
_HALL_HEIGHTS_M = (3.0, 4.0)
_HALL_RANGE_M = 5.0


def random_scene(
    mode: Mode,
    cameras: int,
    targets: int,
    seed: int,
    settings: PlannerSettings = PAPER,
    tag_size_m: float | None = None,
) -> Scene:
    """Draw a scene: heads anywhere below the ceiling, or drones that may fly all over the room; targets anywhere."""
    # The mode and the size are part of the seed: scenes of two sizes share nothing.
    rng = np.random.default_rng([seed, cameras, targets, mode == "drone"])
    return Scene(
        cameras=tuple(_camera(mode, k, rng) for k in range(cameras)),
        targets=_targets(rng.uniform((0.0, 0.0), FLOOR_M, size=(targets, 2)), tag_size_m),
        settings=settings,
    )


def random_hall(cameras: int, targets: int, seed: int) -> Scene:
    """Draw a hall of one head a cell of 4 m x 4 m, as many as there are cameras; targets anywhere.

    A head sees 5 m far: it reaches about two and a half times its share of the targets, however large the hall is.
    """
    rng = np.random.default_rng([seed, cameras, targets])
    rows = next(count for count in range(math.isqrt(cameras), 0, -1) if cameras % count == 0)
    columns = cameras // rows
    corners = np.stack(np.unravel_index(np.arange(cameras), (columns, rows)), axis=1)
    places = _CELL_M * (corners + rng.uniform(0.25, 0.75, size=(cameras, 2)))
    floor_m = (_CELL_M * columns, _CELL_M * rows)
    return Scene(
        cameras=tuple(
            _head(f"c{k + 1}", np.append(place, rng.uniform(*_HALL_HEIGHTS_M))) for k, place in enumerate(places)
        ),
        targets=_targets(rng.uniform((0.0, 0.0), floor_m, size=(targets, 2))),
        settings=PlannerSettings(max_range_m=_HALL_RANGE_M),
    )


def _targets(places: Array, tag_size_m: float | None = None) -> tuple[SceneTarget, ...]:
    return tuple(SceneTarget(f"t{k + 1}", (float(x), float(y), 0.0), tag_size_m) for k, (x, y) in enumerate(places))


def _camera(mode: Mode, k: int, rng: np.random.Generator) -> SceneCamera:
    if mode == "drone":
        place = DronePlace(transform(R_BODY_OPTICAL_DOWN, np.zeros(3)), FLIGHT_BOX_M)
        return SceneCamera(f"d{k + 1}", LAB_LENS, place, pose_sigma=PoseSigma(0.03, math.radians(1.0)))
    return _head(f"c{k + 1}", np.append(rng.uniform((0.0, 0.0), FLOOR_M), rng.uniform(*HEIGHTS_M)))


def _head(name: str, position: Array) -> SceneCamera:
    kinematics, T_mount_camera = PanTilt(transform(np.eye(3), position)), transform(R_MOUNT_OPTICAL, np.zeros(3))
    head = HeadPlace(kinematics, T_mount_camera, PAN_RAD, TILT_RAD)
    bias = math.radians(0.1)
    return SceneCamera(name, LAB_LENS, head, pose_sigma=PoseSigma(pan_rad=bias, tilt_rad=bias))
