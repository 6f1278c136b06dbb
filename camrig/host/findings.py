"""What a check of this computer finds: how it is, and what cures it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from camrig import messages
from camrig.messages import Verdict


@dataclass(frozen=True, slots=True)
class Finding:
    """One check's answer; ``cure`` is empty where there is nothing to cure."""

    about: str
    health: Verdict
    says: str
    cure: str = ""


def worst(findings: Iterable[Finding]) -> Verdict:
    """Return how the computer is as a whole."""
    return messages.worst(finding.health for finding in findings)
