"""Have the compiled kernels ready before the clock runs, and say so: compiling them takes minutes, once."""

from __future__ import annotations

from camrig import detect, locate, optimise
from camrig.cli.console import people
from camrig.optimise import PlannerSettings


def load_kernels(settings: PlannerSettings) -> None:
    """Load the planner's compiled kernels, or compile them where none are kept."""
    with people.status(
        "loading the planner's kernels; after an installation they are compiled once, for about two minutes"
    ):
        optimise.warm_up(settings)


def load_daemons_kernels() -> None:
    """Load those of detection and of the estimate, which a daemon would else compile before it starts, unseen."""
    with people.status(
        "loading the estimate's kernels; after an installation they are compiled once, for about a minute"
    ):
        locate.warm_up()
        detect.warm_up()
