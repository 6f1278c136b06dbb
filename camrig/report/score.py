"""Published positions against the truth of an emulated world: errors and coverage on a common grid of samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camrig.interfaces import Published, World
from camrig.messages import TargetStatus
from camrig.rig import Rig

SAMPLE_S = 0.1
"""The grid, in the world's own time: two runs of one seed are sampled at the same instants."""

Samples = Mapping[tuple[int, str], float | None]
"""Error in metres by (sample number, target id); None where the target was not published."""


@dataclass
class ScoreSink:
    """Scores one published state per sample of the grid."""

    world: World
    samples: dict[tuple[int, str], float | None] = field(default_factory=dict)
    _last: int = -1

    def open(self, rig: Rig) -> None:
        """Need nothing of the rig: every published target is scored."""

    def write(self, published: Published) -> None:
        number = math.floor(self.world.elapsed_s(published.stamp_s) / SAMPLE_S)
        if number == self._last:
            return
        self._last = number
        truth = self.world.truth(published.stamp_s)
        for target in published.targets:
            error_m = float(np.linalg.norm(target.position_m - truth[target.id][:3, 3]))
            self.samples[number, target.id] = error_m if target.status is TargetStatus.TRACKED else None

    def close(self) -> None:
        """Keep the samples."""

    def between(self, from_s: float, to_s: float) -> Samples:
        """Return the samples of a span of the world's time."""
        first, last = math.ceil(from_s / SAMPLE_S), math.floor(to_s / SAMPLE_S)
        return {key: error for key, error in self.samples.items() if first <= key[0] < last}


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Mean and 95th percentile over ``n`` target-samples."""

    mean_m: float
    p95_m: float
    n: int


def coverage(samples: Samples) -> float:
    """Return the share of target-samples that were published at all."""
    return sum(error is not None for error in samples.values()) / len(samples) if samples else math.nan


def errors_on_common(samples: Samples, other: Samples) -> ErrorStatistics:
    """Return the errors of ``samples`` on the target-samples that both runs published."""
    errors = [error for key, error in samples.items() if error is not None and other.get(key) is not None]
    if not errors:
        return ErrorStatistics(math.nan, math.nan, 0)
    return ErrorStatistics(float(np.mean(errors)), float(np.percentile(errors, 95)), len(errors))
