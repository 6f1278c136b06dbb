"""Where tags are on a body, from pictures of it alone: any camera, anywhere, moving or not.

Each picture is an instant of its own, of a body before a camera that nobody asks the place of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.extrinsics import Extrinsics, extrinsics
from camrig.calibrate.setup import CARRIED, Setup
from camrig.calibrate.sighted import Shot
from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.geometry.lens import Lens


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What was found (``body_marks`` of it are the tags), and in how many pictures each tag was with another one."""

    found: Extrinsics
    together: Mapping[str, int]


def layout(
    shots: Sequence[Shot],
    lenses: Mapping[str, Lens],
    sizes_m: Mapping[str, float],
    frame: tuple[str, Transform],
) -> Layout:
    """Find ``T_body_tag`` of all tags in the shots; ``frame`` is the tag that is held, and its ``T_body_tag``.

    Raises InputError where the frame's tag is in no picture, or never with another one.
    """
    apart = [replace(shot, instant=k, aim_rad=None) for k, shot in enumerate(shots)]
    together = {tag: sum(len(shot.corners_px) > 1 for shot in apart if tag in shot.corners_px) for tag in sizes_m}
    if not any(frame[0] in shot.corners_px for shot in apart):
        raise InputError(f"{frame[0]}, on which the body's frame hangs, is in no picture: show it, or choose another")
    if not together.get(frame[0]):
        raise InputError(f"{frame[0]}, on which the body's frame hangs, is never in a picture with another tag")
    kept = {name: np.eye(4) for name in lenses if any(shot.camera_id == name for shot in shots)}
    setup = Setup(lenses=lenses, sizes_m=sizes_m, kept=kept, frames={CARRIED: frame})
    return Layout(extrinsics(apart, setup), together)
