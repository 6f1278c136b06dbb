"""What a check of this computer finds: how it is, and what cures it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Health(StrEnum):
    """Fit, fit with a loss, not fit."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


@dataclass(frozen=True, slots=True)
class Finding:
    """One check's answer; ``cure`` is empty where there is nothing to cure."""

    about: str
    health: Health
    says: str
    cure: str = ""


def worst(findings: Iterable[Finding]) -> Health:
    """Return how the computer is as a whole."""
    order = list(Health)
    return max((finding.health for finding in findings), key=order.index, default=Health.GREEN)
