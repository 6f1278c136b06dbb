"""The zoom of an emulated VISCA head: a command for it holds a socket until the lens is there. Pure."""

from __future__ import annotations

from dataclasses import dataclass

WHOLE = 0x4000
"""From the widest to the narrowest, optically."""


@dataclass(slots=True)
class Zoom:
    """``whole_s`` is what it takes over its whole range."""

    whole_s: float
    socket: int | None = None
    """Held by the command that is being executed."""
    _from: int = 0
    _to: int = 0
    _begun_s: float = 0.0

    def at(self, stamp_s: float) -> int:
        """Return where the lens is."""
        lasts_s = self._lasts_s
        share = min(1.0, (stamp_s - self._begun_s) / lasts_s) if lasts_s else 1.0
        return self._from + round(share * (self._to - self._from))

    def go_to(self, value: int, socket: int, at_s: float) -> None:
        """Begin a command; one before it is no longer executed."""
        self._from, self._to, self._begun_s, self.socket = self.at(at_s), value, at_s, socket

    def cancel(self, at_s: float) -> None:
        """Stay where it is."""
        self._from = self._to = self.at(at_s)
        self.socket = None

    def settle(self, now_s: float) -> int | None:
        """Return the socket of a command that has been executed by now, once; None where there is none."""
        if self.socket is None or now_s < self._begun_s + self._lasts_s:
            return None
        socket, self.socket = self.socket, None
        return socket

    @property
    def _lasts_s(self) -> float:
        return self.whole_s * abs(self._to - self._from) / WHOLE
