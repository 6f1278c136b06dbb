"""One serial VISCA line with its heads, byte by byte in time. Pure: it is told the time and never asks for it.

Bytes take 10 bit times each way (8N1): what the master writes at once is heard one byte after the other, a message
counts from the end of its last byte, and an answer is delivered when its last byte has come through. The two
directions have wires of their own.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence

from camrig_emulators.faults import Faults
from camrig_emulators.head_line import Stamped, shared_baud
from camrig_emulators.visca_device import Answer, ViscaHead
from camrig_emulators.visca_settings import ViscaHeadSettings
from camrig_emulators.visca_wire import BROADCAST, Message, MessageParser

BITS_PER_BYTE = 10
LOG_LENGTH = 20_000


class ViscaBus:
    """Advances by events: ``receive`` what the master wrote, ``transmit`` what has come through by now."""

    def __init__(self, heads: Sequence[ViscaHeadSettings], faults: Faults, seed: int = 0) -> None:
        self.baud = shared_baud(heads)
        self.byte_s = BITS_PER_BYTE / self.baud
        self.heads = {head.id: ViscaHead(head, random.Random(f"{seed} {head.id}")) for head in heads}
        self.received: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self.sent: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self._faults = faults
        self._rng = random.Random(seed)
        self._parser = MessageParser()
        self._incoming: deque[tuple[int, float]] = deque()
        self._incoming_free_s = -math.inf
        self._outgoing: list[Stamped] = []
        self._outgoing_free_s = -math.inf
        self._now_s = -math.inf

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        """Take what the master wrote at ``now_s``, its port set to ``baud``; another baud than ours is noise."""
        data = self._through(data, baud)
        start_s = max(now_s, self._incoming_free_s)
        for count, byte in enumerate(data, start=1):
            self._incoming.append((byte, start_s + count * self.byte_s))
        self._incoming_free_s = start_s + len(data) * self.byte_s
        if self._faults.echo:
            self._send(Answer(start_s, data))

    def advance(self, now_s: float) -> None:
        """Let the heads hear everything that has come through by ``now_s``, and end their motions."""
        self._now_s = now_s
        while self._incoming and self._incoming[0][1] <= now_s:
            byte, end_s = self._incoming.popleft()
            message = self._parser.feed(byte, end_s - self.byte_s, end_s)
            if message is not None:
                self._hear(message)
        for head in self.heads.values():
            self._say(head, head.settle(now_s))

    def transmit(self, now_s: float, baud: int) -> bytes:
        """Return what the master's port has received since the last call, in order, its port set to ``baud``."""
        self.advance(now_s)
        due = sorted(item for item in self._outgoing if item[0] <= now_s)
        self._outgoing = [item for item in self._outgoing if item[0] > now_s]
        self.sent.extend(due)
        return b"".join(self._through(data, baud) for _, data in due)

    def next_s(self) -> float | None:
        """Return when the next message or answer will have come through, or a motion may have ended."""
        ends_s = [end_s for end_s, _ in self._outgoing]
        ends_s += [head.next_s(self._now_s) for head in self.heads.values()]
        if self._incoming:
            ends_s.append(next((end_s for byte, end_s in self._incoming if byte == 0xFF), self._incoming[-1][1]))
        earliest_s = min(ends_s, default=math.inf)
        return None if earliest_s == math.inf else earliest_s

    def cut(self) -> None:
        """Lose all that is under way in both directions: the port was unplugged."""
        self._incoming.clear()
        self._outgoing.clear()
        self._incoming_free_s = self._outgoing_free_s = -math.inf
        self._parser.clear()

    def _hear(self, message: Message) -> None:
        self.received.append((message.end_s, message.raw))
        if self._faults.take_drop():
            return
        if message.address == BROADCAST and message.body == b"\x30\x01":
            self._number_heads(message.end_s)
            return
        for head in self.heads.values():
            if message.address in {head.address, BROADCAST}:
                self._say(head, head.handle(message, frozen=self._faults.freeze))

    def _number_heads(self, at_s: float) -> None:
        """Give the heads of the chain their addresses, in order; the last answer says one more than there are."""
        for number, head in enumerate(self.heads.values(), start=1):
            head.address = number
        self._send(Answer(at_s, bytes((0x88, 0x30, len(self.heads) + 1, 0xFF))))

    def _say(self, head: ViscaHead, answers: Sequence[Answer]) -> None:
        for answer in answers:
            left: Answer | None = answer
            for faults in (head.faults, self._faults):
                left = left and self._suffered(left, faults)
            if left is not None:
                self._send(left)

    def _suffered(self, answer: Answer, faults: Faults) -> Answer | None:
        """Return what is left of an answer; a lost beginning still takes its time."""
        lost, data = faults.cut(answer.data)
        start_s = answer.start_s + faults.latency_s + lost * self.byte_s
        return Answer(start_s, data) if data and not faults.silent else None

    def _send(self, said: Answer) -> None:
        end_s = max(said.start_s, self._outgoing_free_s) + len(said.data) * self.byte_s
        self._outgoing_free_s = end_s
        self._outgoing.append((end_s, said.data))

    def _through(self, data: bytes, baud: int) -> bytes:
        return self._faults.spoil(data if baud == self.baud else self._rng.randbytes(len(data)), self._rng)
