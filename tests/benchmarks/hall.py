"""A program of its own: plan one hall and print what memory that took, as JSON. Its peak is nobody else's."""

from __future__ import annotations

import json
import sys
import time

from camrig import optimise
from camrig.experiments.scenes import random_hall
from tests.benchmarks.memory import peak_mib


def main() -> None:
    cameras, targets = map(int, sys.argv[1:])
    optimise.plan(random_hall(4, 8, 0), now=time.monotonic)
    before_mib = peak_mib()
    optimise.plan(random_hall(cameras, targets, 0), now=time.monotonic)
    print(json.dumps({"peak_mib": round(peak_mib(), 1), "before_mib": round(before_mib, 1)}))


if __name__ == "__main__":
    main()
