"""What something examined is good for: a calibration, this computer."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class Verdict(StrEnum):
    """Good, usable at a loss, not usable; in that order."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst; green of none."""
    return max(verdicts, key=list(Verdict).index, default=Verdict.GREEN)
