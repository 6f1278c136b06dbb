"""One serial line with one or more heads on it: who may speak, when, and what a reply is worth.

- One request is outstanding at a time; whoever wants to speak waits in a queue, so every head is served in turn.
- The line is quiet for a gap before every frame, since heads drop frames that come sooner.
- A stop goes before the queue and cuts short an exchange that waits for its reply. It may then collide with that reply
  on a 2-wire line, so it is repeated as soon as the line is quiet, ahead of anything else.
- A motion carries the permit it was asked under; every stop voids the permits, so no motion queued before a stop is
  sent after it.
- Only a reply that can belong to the request counts: right address, opcode and checksum, not sooner than the line's
  speed allows, and a question that went unanswered is not put again until its late answer would have come.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from typing import TypeVar

from camrig.clock import Clock
from camrig.errors import LinkLost
from camrig_drivers.pelco_d.codec import COMMAND_BYTES, Command, Echo, Extended, Reply, Request, encode, find_reply
from camrig_drivers.pelco_d.commands import STOP
from camrig_drivers.pelco_d.timing import Answer, LinkStatistics, Miss, ReplyTime, timed
from camrig_drivers.serial_port import Port, SerialPort
from camrig_drivers.turns import Turns

T = TypeVar("T")

_BITS_A_BYTE = 10
"""8N1: a start bit, eight data bits, a stop bit."""
_REPEAT_S = 0.25
"""The longest that the repetition of a stop waits for the reply of the exchange it cut short."""
_LATE_S = 0.4
"""How long after its time-out a reply may still come in (adapters hold back up to 0.25 s)."""


@dataclass(frozen=True, slots=True)
class LineSettings:
    """What all heads of one line share."""

    port: str
    baud: int
    gap_s: float = 0.05
    reply_timeout_s: float = 0.1
    """How long a head may take to start its reply, beyond the time both frames take on the wire."""
    echo: Echo = Echo.AUTO
    resync_tail: bool = False


class Bus:
    """The line. Open while at least one head is attached to it; any thread may call."""

    def __init__(
        self,
        settings: LineSettings,
        clock: Clock,
        open_port: Callable[[str, int], SerialPort] = Port,
        make_condition: Callable[[], threading.Condition] = threading.Condition,
    ) -> None:
        """Open nothing yet. Simulated time brings a port and a condition of its own."""
        self.settings = settings
        self.clock = clock
        self._open_port = open_port
        self._turns = Turns(
            self._wake, quiet_s=lambda: self._quiet_from_s - clock.now_s(), make_condition=make_condition
        )
        self._lock = threading.Lock()
        self._quiet_from_s = 0.0
        self._owed_stops: deque[bytes] = deque()
        self._port: SerialPort | None = None
        self._links: set[Link] = set()

    def attach(self, address: int) -> Link:
        """Open the line where it is not, and return one head's use of it; raises LinkLost. Sends nothing."""
        with self._holding(self._turns.turn(), None):
            if self._port is None:
                self._port = self._open_port(self.settings.port, self.settings.baud)
                self._owed_stops.clear()
                self._quiet_from_s = self.clock.now_s()
            link = Link(self, self._port, address)
            with self._lock:
                self._links.add(link)
        return link

    def detach(self, link: Link) -> None:
        """End a link; the last one closes the port once every stop is out. Raises nothing."""
        with suppress(LinkLost):
            self._in_turn(link.port, lambda: self._leave(link))
        with self._lock:
            self._links.discard(link)

    def query(self, port: SerialPort, request: Request, timeout_s: float) -> Answer | Miss:
        """Ask and wait until the reply should have begun ``timeout_s`` ago; raises LinkLost."""
        return self._in_turn(port, lambda: self._converse(port, request, timeout_s))

    def send(self, port: SerialPort, frame: bytes, allowed: Callable[[], bool]) -> bool:
        """Send a frame that nobody answers, if it is still allowed when its turn comes; raises LinkLost."""

        def send_if_allowed() -> bool:
            if allowed():
                self._transmit(port, frame)
                return True
            return False

        return self._in_turn(port, send_if_allowed)

    def stop(self, port: SerialPort, frame: bytes) -> None:
        """Send a stop frame now, ahead of the queue, and owe its repetition; raises LinkLost."""
        with self._holding(self._turns.stop_turn(), port):
            if frame not in self._owed_stops:
                self._owed_stops.append(frame)
            self._transmit(port, frame)

    def _leave(self, link: Link) -> None:
        with self._lock:
            self._links.discard(link)
            last = not any(other.port is link.port for other in self._links)
        if last:
            self._drop(link.port)

    def _in_turn(self, port: SerialPort, work: Callable[[], T]) -> T:
        """Run ``work`` with the line to itself, after the stops that are still owed; each frame has its own gap."""
        while True:
            with self._holding(self._turns.turn(), port):
                if not self._owed_stops:
                    return work()
                self._transmit(port, self._owed_stops.popleft())

    @contextmanager
    def _holding(self, turn: AbstractContextManager[None], port: SerialPort | None) -> Iterator[None]:
        """Take a turn; one in which the port proves lost closes it."""
        with turn:
            try:
                self._require_current(port)
                yield
            except LinkLost:
                if port is not None:
                    self._drop(port)
                raise

    def _require_current(self, port: SerialPort | None) -> None:
        if port is not None and port is not self._port:
            raise LinkLost(f"serial port {port.path} was lost or closed")

    def _drop(self, port: SerialPort) -> None:
        with self._lock:  # so that no stop wakes a port that is being closed
            port.close()
            if self._port is port:
                self._port = None

    def _wake(self) -> None:
        with self._lock:
            if self._port is not None and self._port.is_open:
                self._port.wake()

    def _transmit(self, port: SerialPort, frame: bytes) -> float:
        """Write a frame; return the time at which its last bit will have left."""
        sent_s = self.clock.now_s() + self._on_air_s(len(frame))
        port.write(frame)
        self._quiet_until(sent_s + self.settings.gap_s)
        return sent_s

    def _converse(self, port: SerialPort, request: Request, timeout_s: float) -> Answer | Miss:
        port.discard_input()
        asked_s = self._transmit(port, request.frame)
        reply_s = self._on_air_s(request.reply_bytes)
        deadline_s = asked_s + reply_s + timeout_s
        received, heard_s, miss = b"", asked_s, Miss.SILENT
        while (left_s := deadline_s - self.clock.now_s()) > 0.0:
            if self._turns.stop_waits:
                self._quiet_until(min(deadline_s, self.clock.now_s() + _REPEAT_S))  # the head may still be talking
                return Miss.CUT
            echoed = COMMAND_BYTES if received.startswith(request.frame) else 0
            if not (more := port.read(max(1, echoed + request.reply_bytes - len(received)), left_s)):
                continue
            received, heard_s = received + more, self.clock.now_s()
            if reply := self._found(received, request, final=False):
                if answer := timed(reply, asked_s, heard_s, reply_s):
                    self._quiet_until(heard_s + self.settings.gap_s)
                    return answer
                received, miss = b"", Miss.TOO_SOON  # an older question's answer; ours may follow
            elif miss is Miss.SILENT:
                miss = Miss.GARBLED
        self._quiet_until(deadline_s + self.settings.gap_s)
        last = self._found(received, request, final=True)
        return (last and timed(last, asked_s, heard_s, reply_s)) or miss

    def _found(self, received: bytes, request: Request, *, final: bool) -> Reply | None:
        settings = self.settings
        return find_reply(received, request, echo=settings.echo, resync_tail=settings.resync_tail, final=final)

    def _quiet_until(self, stamp_s: float) -> None:
        self._quiet_from_s = max(self._quiet_from_s, stamp_s)

    def _on_air_s(self, length: int) -> float:
        return length * _BITS_A_BYTE / self.settings.baud


class Link:
    """One head's use of the line, from attaching to closing. Everything but ``close`` may raise LinkLost."""

    def __init__(self, bus: Bus, port: SerialPort, address: int) -> None:
        self.port = port
        self.permit = object()
        """What a motion must show to be sent; every stop makes a new one, and old ones are void."""
        self.reply_time = ReplyTime(bus.settings.reply_timeout_s)
        self.statistics = LinkStatistics()
        self._bus = bus
        self._address = address
        self._ask_again_s: dict[Command, float] = {}

    def ask(self, command: Command) -> Answer | Miss:
        """Put a query and wait for its answer; after a miss the same query first waits until a late answer is past."""
        clock = self._bus.clock
        if (wait_s := self._ask_again_s.pop(command, -math.inf) - clock.now_s()) > 0.0:
            clock.sleep_s(wait_s)
        self.statistics.asked += 1
        answer = self._bus.query(self.port, Request(self._address, command), self.reply_time.timeout_s)
        if isinstance(answer, Miss):
            self._ask_again_s[command] = clock.now_s() + _LATE_S
            self.statistics.count(answer)
            self.reply_time.missed()
        else:
            self.statistics.answered += 1
            self.statistics.degraded += isinstance(answer.reply, Extended) and answer.reply.degraded
            self.reply_time.heard(answer)
        return answer

    def move(self, command: Command, permit: object) -> bool:
        """Send a motion; False where a stop has voided its permit, and then nothing is sent."""
        sent = self._bus.send(self.port, encode(self._address, command), lambda: permit is self.permit)
        self.statistics.moves += sent
        self.statistics.voided += not sent
        return sent

    def stop(self) -> None:
        """Void every permit and send stop, ahead of everything; any thread."""
        self.permit = object()
        self.statistics.stops += 1
        self._bus.stop(self.port, encode(self._address, STOP))

    def close(self) -> None:
        """Let go of the line; twice is allowed."""
        self._bus.detach(self)
