"""Have the compiled refinement of corners ready before pictures come, and say so."""

from __future__ import annotations

from camrig.cli.console import people
from camrig.detect import warm_up


def load_refinement() -> None:
    """Load it, or compile it where nothing is kept."""
    with people.status("loading refinement; after an installation it is compiled once, for a quarter of a minute"):
        warm_up()
