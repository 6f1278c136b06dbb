"""What an operator should read."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How much an event matters."""

    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Event:
    """Something an operator should read: which thing, what happened, what it costs."""

    stamp_s: float
    level: Level
    about: str
    text: str
