"""A head, its camera and eight tags: what the camera sees of them, without any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camrig.calibrate.head_model import AxisModel, HeadModel, HeadShot
from camrig.geometry.arrays import Transform
from camrig.geometry.pose import perturb
from tests.head_stand import BASE, SIZE_M, T_WORLD_TAG, camera_in_mount
from tests.simulated_room import LENS, tag_in_picture

TAGS = {str(key): T for key, T in T_WORLD_TAG.items()}
SIZES_M = dict.fromkeys(TAGS, SIZE_M)
ARM = perturb(np.eye(4), np.array([0.02, 0.0, 0.0, 0.01, 0.0, 0.0]))
TRUE = HeadModel(
    BASE,
    ARM,
    camera_in_mount((0.03, 0.02, 0.05), (0.8, 0.0, -1.2)),
    (AxisModel(0.0, -1.36, 0.1, 0.006), AxisModel(0.0, 0.9, -0.05, 0.004)),
)
FILE = HeadModel(BASE, np.eye(4), camera_in_mount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (AxisModel(), AxisModel()))
ROUGH = replace(FILE, axes=(AxisModel(0.0, -1.38), AxisModel(0.0, 0.92, -0.03)))


def seen_from(
    aims_deg: Sequence[tuple[float, float]], true: HeadModel = TRUE, tags: dict[str, Transform] | None = None
) -> list[HeadShot]:
    """Return what the camera sees at angles of the optics, each from both sides."""
    rng = np.random.default_rng(1)
    shots: list[HeadShot] = []
    for travel in (1.0, -1.0):
        for pan_deg, tilt_deg in aims_deg:
            line_rad = np.radians([pan_deg, tilt_deg])
            pairs = zip(line_rad, true.axes, strict=True)
            reported = np.array([(line - axis.offset_rad) / axis.factor for line, axis in pairs])
            both = np.full(2, travel)
            T = true.T_world_camera(*true.angles_rad(reported[None], both[None])[0])
            seen = {name: tag_in_picture(LENS, T, tag, SIZE_M) for name, tag in (tags or TAGS).items()}
            corners = {name: px + rng.normal(0.0, 0.05, (4, 2)) for name, px in seen.items() if px is not None}
            shots.append(HeadShot(reported, both, corners, float(len(shots))))
    return shots


AIMS_DEG = [(pan, tilt) for pan in range(-80, 81, 20) for tilt in (-70, -50, -35)]
