"""Emulated heads on one serial line, on a pseudo-terminal that any driver can open, and the truth of their optics."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from typing import Generic, Protocol, TypeVar

from camrig.clock import Clock
from camrig.errors import InputError
from camrig_emulators.faults import Faults
from camrig_emulators.pty_line import PtyLine

Stamped = tuple[float, bytes]


class _Settings(Protocol):
    @property
    def id(self) -> str: ...

    @property
    def baud(self) -> int: ...


class _Head(Protocol):
    @property
    def faults(self) -> Faults: ...

    def true_angles_deg(self, stamp_s: float) -> tuple[float, float]: ...


HeadT_co = TypeVar("HeadT_co", bound=_Head, covariant=True)


class _Bus(Protocol[HeadT_co]):
    """The line in time; stepped by whoever holds it."""

    baud: int

    @property
    def heads(self) -> Mapping[str, HeadT_co]: ...

    @property
    def received(self) -> Sequence[Stamped]: ...

    @property
    def sent(self) -> Sequence[Stamped]: ...

    def receive(self, data: bytes, now_s: float, baud: int) -> None: ...

    def transmit(self, now_s: float, baud: int) -> bytes: ...

    def advance(self, now_s: float) -> None: ...

    def next_s(self) -> float | None: ...

    def cut(self) -> None: ...


def shared_baud(heads: Sequence[_Settings]) -> int:
    """Return the baud rate of heads on one line; raises InputError where they clash."""
    if len({head.id for head in heads}) < len(heads):
        raise InputError(f"heads of one emulated line need ids of their own, not {[head.id for head in heads]}")
    if len(bauds := {head.baud for head in heads}) != 1:
        raise InputError(f"heads of one emulated line share one baud rate, not {sorted(bauds)}")
    return heads[0].baud


class HeadLine(Generic[HeadT_co]):
    """One serial line with one or more heads. Everything here may be called from any thread.

    Until ``start`` there is neither a thread nor a port: with ``receive``, ``transmit`` and ``next_s`` a test steps
    the line by itself, in whatever time it likes.
    """

    def __init__(self, bus: _Bus[HeadT_co], faults: Faults, clock: Clock, name: str) -> None:
        """Put a bus on a port; ``name`` is the last part of its path."""
        self.faults = faults
        self._bus = bus
        self._clock = clock
        self._lock = threading.RLock()
        self.baud: int = bus.baud
        self._line = PtyLine(name, self, clock=clock, faults=faults)

    @property
    def head_faults(self) -> Mapping[str, Faults]:
        """The faults of single heads, by id; those of the whole line are ``faults``."""
        return {name: head.faults for name, head in self._bus.heads.items()}

    @property
    def received(self) -> list[Stamped]:
        """Every whole message that came over the wire, to any address: (end of its last byte, bytes)."""
        with self._lock:
            return list(self._bus.received)

    @property
    def sent(self) -> list[Stamped]:
        """Every answer that went out, as far as faults left it whole: (end of its last byte, bytes)."""
        with self._lock:
            return list(self._bus.sent)

    @property
    def port(self) -> str:
        """The path that a driver opens; raises RuntimeError before ``start``."""
        return self._line.path

    def start(self) -> str:
        self._line.start()
        return self._line.path

    def stop(self) -> None:
        self._line.stop()

    def true_angles_rad(self, head_id: str, stamp_s: float) -> tuple[float, float]:
        """Return where the optics of a head truly pointed: pan and tilt of docs/frames-and-units.md.

        Exact for any stamp of the last minute; a stamp to come is where the commands heard so far lead.
        """
        with self._lock:
            self._bus.advance(self._clock.now_s())
            pan_deg, tilt_deg = self._bus.heads[head_id].true_angles_deg(stamp_s)
        return math.radians(pan_deg), math.radians(tilt_deg)

    def describe(self) -> str:
        with self._lock:
            now_s = self._clock.now_s()
            self._bus.advance(now_s)
            return "; ".join(self._describe(name, now_s) for name in self._bus.heads)

    # --- the far end of a serial line (pty_line.SerialDevice) -------------------------------------------------

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        with self._lock:
            self._bus.receive(data, now_s, baud)

    def transmit(self, now_s: float, baud: int) -> bytes:
        with self._lock:
            return self._bus.transmit(now_s, baud)

    def next_s(self) -> float | None:
        with self._lock:
            return self._bus.next_s()

    def cut(self) -> None:
        with self._lock:
            self._bus.cut()

    def _describe(self, name: str, now_s: float) -> str:
        """Return one head in words, for whoever watches the emulator."""
        raise NotImplementedError
