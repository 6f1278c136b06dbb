"""What is wrong with pictures is told once as it begins and once as it ends, however often it is seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.messages import Event, Level

OVER_S = 2.0
"""What has not been seen for so long is over: a lamp that flickers is one complaint, not thirty a second."""


@dataclass
class Complaints:
    """What one device is complained of; ``tell`` takes what an operator should read."""

    about: str
    tell: Callable[[Event], None]
    _open: dict[str, tuple[str, float]] = field(default_factory=dict)

    def take(self, stamp_s: float, faults: Mapping[str, str]) -> None:
        """Take what is wrong with the picture of this stamp: a sentence by kind; of a kind the first one is told."""
        for kind, sentence in faults.items():
            if kind not in self._open:
                self.tell(Event(stamp_s, Level.WARNING, self.about, sentence))
            self._open[kind] = self._open.get(kind, (sentence, 0.0))[0], stamp_s
        for kind, (sentence, seen_s) in list(self._open.items()):
            if stamp_s > seen_s + OVER_S:
                del self._open[kind]
                self.tell(Event(stamp_s, Level.INFO, self.about, f"no longer so: {sentence}"))
