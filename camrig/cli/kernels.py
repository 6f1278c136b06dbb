"""Have the planner's kernels ready before the clock runs, and say so: compiling them takes minutes, once."""

from __future__ import annotations

from camrig import optimise
from camrig.cli.console import people
from camrig.optimise import PlannerSettings


def load_kernels(settings: PlannerSettings) -> None:
    """Load the compiled kernels, or compile them where none are kept."""
    with people.status(
        "loading the planner's kernels; after an installation they are compiled once, for about two minutes"
    ):
        optimise.warm_up(settings)
