"""What happened in each tick of a simulated run, and how far published targets were from the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Transform
from camrig.messages import TargetStatus
from camrig.pipeline import Inputs, Outputs


@dataclass(frozen=True)
class Tick:
    """One call of ``pipeline.step``: what went in, what came out, and where the targets truly were."""

    now_s: float
    inputs: Inputs
    outputs: Outputs
    scanning: bool
    truth: Mapping[str, Transform]


@dataclass(frozen=True)
class Score:
    """Published targets against the truth: share tracked, mean and largest error in metres over ``n`` samples."""

    coverage: float
    mean_error_m: float
    p95_error_m: float
    n: int


def score(ticks: Sequence[Tick]) -> Score:
    """Score every target of the rig in every tick."""
    errors = [
        float(np.linalg.norm(target.position_m - tick.truth[target.id][:3, 3]))
        if target.status is TargetStatus.TRACKED
        else math.nan
        for tick in ticks
        for target in tick.outputs.published.targets
    ]
    tracked = [error for error in errors if not math.isnan(error)]
    return Score(len(tracked) / len(errors), float(np.mean(tracked)), float(np.percentile(tracked, 95)), len(errors))
