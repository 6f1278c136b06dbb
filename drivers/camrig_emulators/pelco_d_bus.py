"""One serial line with its heads, byte by byte in time. Pure: it is told the time and never asks for it.

Bytes take 10 bit times each way (8N1): what the master writes at once is heard one byte after the other, a command
counts from the end of its last byte, and an answer is delivered when its last byte has come through.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from camrig.errors import InputError
from camrig_emulators.fault_script import FaultScript, Happening
from camrig_emulators.faults import Faults
from camrig_emulators.head_line import Stamped, shared_baud
from camrig_emulators.pelco_d_device import Answer, PelcoDHead
from camrig_emulators.pelco_d_settings import PelcoDHeadSettings
from camrig_emulators.pelco_d_wire import Command, CommandParser

BITS_PER_BYTE = 10
LOG_LENGTH = 20_000


@dataclass(slots=True)
class Transmission:
    """Bytes on their way to the master; ``sender`` is None for an adapter's echo."""

    sender: str | None
    start_s: float
    end_s: float
    data: bytes


class PelcoDBus:
    """Advances by events: ``receive`` what the master wrote, ``transmit`` what has come through by now."""

    def __init__(
        self, heads: Sequence[PelcoDHeadSettings], faults: Faults, seed: int = 0, script: FaultScript | None = None
    ) -> None:
        self.baud = shared_baud(heads)
        self.byte_s = BITS_PER_BYTE / self.baud
        self.heads = {head.id: PelcoDHead(head, random.Random(f"{seed} {head.id}")) for head in heads}
        self.received: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self.sent: deque[Stamped] = deque(maxlen=LOG_LENGTH)
        self._faults = faults
        self._script = script or FaultScript(())
        self._rng = random.Random(seed)
        self._parser = CommandParser()
        self._incoming: deque[tuple[int, float]] = deque()
        self._incoming_free_s = 0.0
        self._outgoing: list[Transmission] = []
        self._talks_until_s: dict[str, float] = {}

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        """Take what the master wrote at ``now_s``, its port set to ``baud``; another baud than ours is noise."""
        self.advance(now_s)
        data = self._through(data, baud)
        start_s = max(now_s, self._incoming_free_s)
        for count, byte in enumerate(data, start=1):
            self._incoming.append((byte, start_s + count * self.byte_s))
        self._incoming_free_s = start_s + len(data) * self.byte_s
        if self._faults.echo:
            echoed = data[: self._faults.echo_bytes]
            later_s = self._faults.echo_delay_s
            self._put(Transmission(None, start_s + later_s, start_s + later_s + len(echoed) * self.byte_s, echoed))

    def advance(self, now_s: float) -> None:
        """Let the heads hear everything that has come through by ``now_s``, and what is scripted happen."""
        for action in self._script.due(now_s):
            self._hear_until(action.stamp_s)
            self._happen(action)
        self._hear_until(now_s)

    def _happen(self, action: Happening) -> None:
        """Do one thing of the script, to the line or to one head."""
        if action.head is not None and action.head not in self.heads:
            raise InputError(f"the fault script names head '{action.head}'; there are {', '.join(self.heads)}")
        heads = [self.heads[action.head]] if action.head is not None else list(self.heads.values())
        if action.name == "reset":
            for head in heads:
                head.power_cut(action.stamp_s)
        elif action.name == "alarm":
            for head in heads:
                head.alarms.add(round(action.value))
        else:
            action.set(self._faults if action.head is None else heads[0].faults)

    def _hear_until(self, now_s: float) -> None:
        while self._incoming and self._incoming[0][1] <= now_s:
            byte, end_s = self._incoming.popleft()
            command = self._parser.feed(byte, end_s - self.byte_s, end_s)
            if command is not None:
                self._hear(command)

    def transmit(self, now_s: float, baud: int) -> bytes:
        """Return what the master's port has received since the last call, in order, its port set to ``baud``."""
        self.advance(now_s)
        due = sorted((item for item in self._outgoing if item.end_s <= now_s), key=lambda item: item.end_s)
        self._outgoing = [item for item in self._outgoing if item.end_s > now_s]
        self.sent.extend((item.end_s, item.data) for item in due if item.sender is not None)
        return b"".join(self._through(item.data, baud) for item in due)

    def next_s(self) -> float | None:
        """Return when the next command or answer will have come through, or something is scripted; None for never."""
        ends_s = [item.end_s for item in self._outgoing]
        if (scripted_s := self._script.next_s()) is not None:
            ends_s.append(scripted_s)
        if self._incoming:
            ends_s.append(self._incoming[min(self._parser.missing, len(self._incoming)) - 1][1])
        return min(ends_s, default=None)

    def cut(self) -> None:
        """Lose all that is under way in both directions: the port was unplugged."""
        self._incoming.clear()
        self._outgoing.clear()
        self._incoming_free_s = 0.0

    def _hear(self, command: Command) -> None:
        self.received.append((command.end_s, command.raw))
        if self._faults.take_drop():
            return
        for name, head in self.heads.items():
            if head.settings.half_duplex and self._is_talking(name, command):
                continue
            answer = head.handle(command, frozen=self._faults.freeze)
            for faults in (head.faults, self._faults):
                answer = answer and self._suffered(answer, faults)
            if answer is not None:
                self._send(name, answer)

    def _is_talking(self, name: str, command: Command) -> bool:
        """Say whether a head still answered, or turned round, when a command came in."""
        until_s = self._talks_until_s.get(name, -math.inf) + self.heads[name].settings.turn_around_s
        return command.start_s < until_s

    def _suffered(self, answer: Answer, faults: Faults) -> Answer | None:
        """Return what is left of an answer; a lost beginning still takes its time."""
        lost, data = faults.cut(answer.data)
        start_s = answer.start_s + faults.latency_s + lost * self.byte_s
        return Answer(start_s, data) if data and not faults.silent else None

    def _send(self, name: str, said: Answer) -> None:
        """Put an answer on the wire after this head's earlier ones; two heads at once make noise of both."""
        lost = self.heads[name].settings.lost_first
        data = self._faults.noise_before(self._rng) + said.data[lost:]
        first_s = said.start_s + lost * self.byte_s
        start_s = max([first_s, *(item.end_s for item in self._outgoing if item.sender == name)])
        answer = Transmission(name, start_s, start_s + len(data) * self.byte_s, data)
        for other in self._outgoing:
            if other.sender not in {None, name} and other.start_s < answer.end_s and answer.start_s < other.end_s:
                other.data, answer.data = self._noise(other.data), self._noise(answer.data)
        self._talks_until_s[name] = answer.end_s
        self._put(answer)

    def _put(self, item: Transmission) -> None:
        if not self._faults.splits:
            self._outgoing.append(item)
            return
        for count in range(len(item.data)):
            start_s = item.start_s + count * self.byte_s
            self._outgoing.append(
                Transmission(item.sender, start_s, start_s + self.byte_s, item.data[count : count + 1])
            )

    def _through(self, data: bytes, baud: int) -> bytes:
        return self._faults.spoil(data if baud == self.baud else self._noise(data), self._rng)

    def _noise(self, data: bytes) -> bytes:
        return self._rng.randbytes(len(data))
