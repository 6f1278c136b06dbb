"""What a calibration found of a head, in the terms in which its driver reported while it was calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

HeadGrade = Literal["absolute", "servo", "open loop"]
"""It goes to positions and tells where it is; it tells where it is; neither."""


@dataclass(frozen=True, slots=True)
class AxisFindings:
    """One axis: ``angle = line + sine_rad sin(line) + cosine_rad cos(line)`` of ``line = factor * reported +
    offset_rad``, behind by half of ``play_rad`` on the side from which it came.

    ``drive`` is -1 where positive steps of speed turn towards falling angles; ``speeds_rad_s`` are true ones by step.
    """

    factor: float
    offset_rad: float
    play_rad: float
    sine_rad: float = 0.0
    cosine_rad: float = 0.0
    drive: Literal[-1, 1] = 1
    speeds_rad_s: Mapping[int, float] = field(default_factory=dict)
    acceleration_rad_s2: float | None = None


@dataclass(frozen=True, slots=True)
class HeadFindings:
    """Both axes and their time: what is reported was so ``report_age_s`` before its stamp, by the camera's stamps;
    motion begins ``start_s`` after a command, and is off its speed by ``speed_sigma`` of it, one sigma. None where it
    was not found.
    """

    pan: AxisFindings
    tilt: AxisFindings
    grade: HeadGrade
    report_age_s: float | None = None
    start_s: float | None = None
    speed_sigma: float | None = None
