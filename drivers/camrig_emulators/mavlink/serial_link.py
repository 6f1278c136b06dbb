"""The emulated drone at the end of a serial line: bytes take their time, and telemetry thins out to what fits."""

from __future__ import annotations

import random
import threading
from collections import deque

from camrig_emulators.delayed import Address, Delayed
from camrig_emulators.faults import Faults
from camrig_emulators.socket_port import DatagramDevice

SERIAL: Address = ("serial", 0)
"""Whoever is at the other end."""

_BITS_PER_BYTE = 10
_BUFFER_BYTES = 2048
_LONGEST_WAIT_S = 0.1


class SerialLink:
    """A ``SerialDevice`` that carries one protocol, whose ``target`` must be ``SERIAL``."""

    def __init__(self, protocol: DatagramDevice, lock: threading.Lock, faults: Faults, baud: int, seed: int) -> None:
        self.baud = baud
        self._protocol = protocol
        self._lock = lock
        self._faults = faults
        self._rng = random.Random(seed)
        self._late = Delayed()
        self._line: deque[tuple[float, bytes]] = deque()
        """What is on its way, by the time at which its last byte arrives."""
        self._per_byte_s = _BITS_PER_BYTE / baud
        self._free_at_s = 0.0
        self._next_s = 0.0
        self._polled_s = 0.0

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        """Take what was written; at another rate it is noise."""
        heard = self._faults.spoil(data if baud == self.baud else self._rng.randbytes(len(data)), self._rng)
        with self._lock:
            out = self._protocol.receive(now_s, SERIAL, heard)
        self._late.post(out, now_s + self._faults.latency_s)

    def transmit(self, now_s: float, baud: int) -> bytes:
        """Return what has arrived; while much is under way, telemetry waits."""
        self._polled_s = now_s
        self._next_s = self._free_at_s - _BUFFER_BYTES * self._per_byte_s / 2.0
        if self._next_s <= now_s:
            with self._lock:
                out = self._protocol.poll(now_s)
                self._next_s = self._protocol.next_due_s(now_s)
            self._late.post(out, now_s + self._faults.latency_s)
        for _, data in self._late.due(now_s):
            self._put_on_line(data, now_s)
        arrived = bytearray()
        while self._line and self._line[0][0] <= now_s:
            arrived += self._line.popleft()[1]
        told = bytes(arrived) if baud == self.baud else self._rng.randbytes(len(arrived))
        return self._faults.spoil(told, self._rng)

    def next_s(self) -> float | None:
        """Return when something is due."""
        arrives_s = self._line[0][0] if self._line else float("inf")
        return min(self._next_s, self._late.next_s(), arrives_s, self._polled_s + _LONGEST_WAIT_S)

    def cut(self) -> None:
        """Lose what is under way."""
        self._late.clear()
        self._line.clear()

    def _put_on_line(self, data: bytes, now_s: float) -> None:
        begins_s = max(now_s, self._free_at_s)
        if self._faults.silent or begins_s - now_s > _BUFFER_BYTES * self._per_byte_s:
            return
        self._free_at_s = begins_s + len(data) * self._per_byte_s
        self._line.append((self._free_at_s, data))
