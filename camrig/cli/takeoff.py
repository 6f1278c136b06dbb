"""``camrig takeoff``: the same order as ``camrig arm``, under the name under which a pilot looks for it."""

from camrig.cli.arm import arm as takeoff

__all__ = ["takeoff"]
