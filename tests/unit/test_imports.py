"""What is loaded when: a daemon is to start, and a stop to be sent, without waiting for the planner's libraries."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import pytest

from camrig import optimise

PLANNERS = ("scipy.optimize", "scipy.spatial", "camrig.optimise.planner", "matplotlib")


@pytest.mark.parametrize(("command", "heavy"), [("run", PLANNERS), ("stop", ("numba", *PLANNERS))])
def test_a_command_that_must_be_quick_loads_no_planner(command: str, heavy: tuple[str, ...]) -> None:
    """The daemon itself has kernels, of its estimate; an operator's stop needs none."""
    program = f"import sys, camrig.cli.{command}\nprint([name for name in {heavy!r} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said == "[]\n"


def test_every_public_name_of_the_planner_is_there_when_used() -> None:
    for _ in range(2):  # a module of the name of what it holds would take its place once it is loaded
        assert not [name for name in optimise.__all__ if isinstance(getattr(optimise, name), ModuleType)]
    with pytest.raises(AttributeError, match="no attribute 'warm_down'"):
        optimise.warm_down  # noqa: B018
