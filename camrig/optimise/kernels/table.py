"""What each candidate vector of a camera sees and adds, as sparse rows. Compiled.

Never dense: a row holds only the targets that are seen, among those that the camera can reach at all.
"""

from __future__ import annotations

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.optimise.kernels.pose import lens_of, pose_of
from camrig.optimise.kernels.problem import CHANNELS, NEEDS_ANCHOR, QUALITY, Ints, Problem
from camrig.optimise.kernels.sight import cone_cosine, sees
from camrig.optimise.kernels.worth import add_worth, known_pose, quality_of

_FINEST_M, _COARSEST_M = 1e-9, 100.0
"""What else a camera tells of a target's place is beyond what numbers can hold beside another camera's view."""


@compiled
def look(problem: Problem, i: int, u: Array, reachable: Ints, seen: Ints, worths: Array) -> int:
    """Fill which of the reachable targets camera ``i`` sees from a vector and what it adds; returns how many.

    A camera that must see an anchor and does not is as good as blind.
    """
    if problem.cameras[i, NEEDS_ANCHOR] > 0.0 and not anchored(problem, i, u):
        return 0
    lens = lens_of(problem.cameras[i], problem.lenses, u)
    R, origin = pose_of(problem.cameras[i], u)
    cosine = cone_cosine(problem.settings, lens)
    quality = int(problem.settings[QUALITY])
    channels = CHANNELS[quality]
    known = np.empty((0, 0))
    count = 0
    for j in reachable:
        if not sees(problem.settings, problem.boxes, lens, cosine, R, origin, problem.targets[j]):
            continue
        if count == 0:
            known = known_pose(problem, i, u, lens, R, origin)
        for c in range(channels):
            worths[count, c] = 0.0
        add_worth(quality, lens, R, origin, known, problem.targets[j], 1.0, worths[count])
        if not (_FINEST_M < quality_of(worths[count], quality) < _COARSEST_M):
            continue
        seen[count] = j
        count += 1
    return count


@compiled
def anchored(problem: Problem, i: int, u: Array) -> bool:
    """Tell whether camera ``i`` sees an anchor from a vector."""
    lens = lens_of(problem.cameras[i], problem.lenses, u)
    R, origin = pose_of(problem.cameras[i], u)
    cosine = cone_cosine(problem.settings, lens)
    for k in range(len(problem.anchors)):
        if sees(problem.settings, problem.boxes, lens, cosine, R, origin, problem.anchors[k]):
            return True
    return False


@compiled
def rows_of(problem: Problem, i: int, vectors: Array, reachable: Ints) -> tuple[Ints, Ints, Array]:
    """Return sparse rows of vectors (K, 6): ends (K + 1,), targets (N,), worths (N, C)."""
    channels = CHANNELS[int(problem.settings[QUALITY])]
    ends = np.zeros(len(vectors) + 1, dtype=np.int64)
    targets = np.empty(max(64, 4 * len(vectors)), dtype=np.int64)
    worths = np.empty((len(targets), channels))
    seen, found = np.empty(len(reachable), dtype=np.int64), np.empty((len(reachable), channels))
    for k in range(len(vectors)):
        count = look(problem, i, vectors[k], reachable, seen, found)
        start, end = ends[k], ends[k] + count
        if end > len(targets):
            targets = np.concatenate((targets, np.empty(end + len(targets), dtype=np.int64)))
            worths = np.concatenate((worths, np.empty((len(targets) - len(worths), channels))))
        targets[start:end] = seen[:count]
        worths[start:end] = found[:count]
        ends[k + 1] = end
    return ends, targets[: ends[-1]].copy(), worths[: ends[-1]].copy()


@compiled
def largest_of_each(targets: Ints, worths: Array) -> Array:
    """Return the largest of the worths (N,) of each target, up to the last target there is."""
    best = np.zeros(targets.max() + 1)
    for k in range(len(targets)):
        best[targets[k]] = max(best[targets[k]], worths[k])
    return best
