"""Coverage first, after Aghajanzadeh et al. Pure.

Our reimplementation. Assumed: one camera after another, in the order of the scene, takes of camrig's own candidates the
one that covers most weight that nobody covers yet, the one of lowest cost (the sum of the weighted qualities) at a tie;
nothing is revisited. Drones keep apart from those placed before them.
"""

from __future__ import annotations

import numpy as np

from camrig.optimise.comparators.common import Asked, Found
from camrig.optimise.configuration import empty_sums
from camrig.optimise.kernels.descent import begin
from camrig.optimise.search import table_of


def find(asked: Asked) -> Found:
    """Place the cameras one by one."""
    table = table_of(asked.task, asked.scene.cameras)
    count = len(asked.scene.cameras)
    chosen, best_always = np.full(count, -1, dtype=np.int64), np.full(count, -1.0)
    sums, unused = empty_sums(asked.task, 0.0), np.zeros(count, dtype=np.bool_)
    begin(table, sums, chosen, np.arange(count), best_always, unused)
    return Found(table.vectors[chosen])
