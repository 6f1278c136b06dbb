"""One VISCA head behind UDP, a message a datagram, with Sony's header or without. Pure: it is told the time.

With the header every message carries a number that grows. One that does not grow is refused with ``0F 01`` (it was
heard before), until the controller resets the count; a reply carries the number of what it answers.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque

from camrig_emulators.delayed import Address, Datagram
from camrig_emulators.faults import Faults
from camrig_emulators.visca_device import Answer, ViscaHead
from camrig_emulators.visca_settings import ViscaHeadSettings
from camrig_emulators.visca_wire import (
    COMMAND,
    CONTROL,
    CONTROL_REPLY,
    END,
    INQUIRY,
    LONGEST,
    REPLY,
    Message,
    header,
    with_header,
)

LOG_LENGTH = 20_000
RESET, RESET_DONE = b"\x01", b"\x01"
WRONG_SEQUENCE, WRONG_TYPE = b"\x0f\x01", b"\x0f\x02"
_HALF = 1 << 31
_WHOLE = 1 << 32

Stamped = tuple[float, bytes]


class ViscaDatagrams:
    """A ``udp_port.DatagramDevice``; ``received`` and ``sent`` log messages without their headers."""

    def __init__(self, settings: ViscaHeadSettings, faults: Faults, *, sony: bool, seed: int = 0) -> None:
        self.head = ViscaHead(settings, random.Random(f"{seed} {settings.id}"))
        self.received: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self.sent: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self._faults = faults
        self._sony = sony
        self._last: int | None = None
        """The newest sequence number; any may follow a start or a reset."""
        self._controller: tuple[Address, int] | None = None
        """Who spoke last, and the number of the last command: completions go there."""
        self._due: list[tuple[float, int, Datagram]] = []  # a heap, by the time of sending
        self._count = 0

    def receive(self, now_s: float, address: Address, data: bytes) -> list[Datagram]:
        self._settle(now_s)
        for message, sequence in self._messages(now_s, address, data):
            self.received.append((now_s, message.raw))
            if self._faults.take_drop():
                continue
            self._controller = (address, sequence)
            for answer in self.head.handle(message, frozen=self._faults.freeze):
                self._post(address, answer, sequence)
        return self.poll(now_s)

    def poll(self, now_s: float) -> list[Datagram]:
        self._settle(now_s)
        out = []
        while self._due and self._due[0][0] <= now_s:
            due_s, _, (address, data) = heapq.heappop(self._due)
            self.sent.append((due_s, data[8:] if self._sony else data))
            out.append((address, data))
        return out

    def next_due_s(self, now_s: float) -> float:
        return min(self.head.next_s(now_s), self._due[0][0] if self._due else math.inf)

    def _messages(self, now_s: float, address: Address, data: bytes) -> list[tuple[Message, int]]:
        """Return the messages of a datagram with their number; answers control messages itself."""
        if not self._sony:
            parts = [part + bytes((END,)) for part in data.split(bytes((END,)))[:-1]]
            return [(Message(part, now_s, now_s), 0) for part in parts if len(part) > 2 and part[0] == 0x81]
        found = header(data)
        if found is None:
            return []
        kind, sequence, payload = found
        if kind == CONTROL:
            self._last = None if payload == RESET else self._last
            self._put(now_s, address, with_header(CONTROL_REPLY, sequence, RESET_DONE))
            return []
        if kind not in {COMMAND, INQUIRY} or (payload[1:2] == b"\x09") != (kind == INQUIRY):
            self._put(now_s, address, with_header(CONTROL_REPLY, sequence, WRONG_TYPE))
            return []
        if self._last is not None and not 0 < (sequence - self._last) % _WHOLE < _HALF:
            self._put(now_s, address, with_header(CONTROL_REPLY, sequence, WRONG_SEQUENCE))
            return []
        self._last = sequence
        whole = payload[-1:] == bytes((END,)) and payload[0] == 0x81 and len(payload) <= LONGEST
        return [(Message(payload, now_s, now_s), sequence)] if whole else []

    def _settle(self, now_s: float) -> None:
        for answer in self.head.settle(now_s):
            if self._controller is not None:
                self._post(self._controller[0], answer, self._controller[1])

    def _post(self, address: Address, answer: Answer, sequence: int) -> None:
        _, data = self._faults.cut(answer.data)
        if data:
            self._put(answer.start_s, address, with_header(REPLY, sequence, data) if self._sony else data)

    def _put(self, due_s: float, address: Address, data: bytes) -> None:
        self._count += 1
        heapq.heappush(self._due, (due_s, self._count, (address, data)))
