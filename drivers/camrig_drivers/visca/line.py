"""One port with one or more heads on it: who may speak, when, and what a reply is worth.

- One message is outstanding at a time; whoever wants to speak waits for its turn, so every head is served.
- A stop goes first and cuts short an exchange that waits for its reply. Nothing on the wire says that it arrived until
  it is answered, and a camera that is busy with two commands refuses a third: so it goes with a cancel of both, and is
  repeated until the head has acknowledged it.
- A motion carries the permit it was asked under; every stop voids the permits, so no motion from before a stop is sent
  after it.
- Only a reply that can belong to the message counts: from its head, of its kind, of its number where there are numbers,
  not sooner than the line's speed allows; and an inquiry that went unanswered is not put again until its late answer
  would have come.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum

from camrig.clock import Clock
from camrig.errors import LinkLost
from camrig_drivers.turns import Turns
from camrig_drivers.visca.codec import (
    SOCKETS,
    Acknowledged,
    Completed,
    Error,
    Refused,
    Reply,
    cancel,
    message,
)
from camrig_drivers.visca.transport import Heard, Transport

_log = logging.getLogger(__name__)

_BAUD_TOLERANCE_S = 1e-3
"""A reply may seem to begin this much before its question has ended: clocks, and UARTs a little too fast."""
_AGAIN_S = 0.25
"""After so long a stop is said again: cameras refuse everything for about 0.2 s after a cancel."""
_STOP_TRIES = 5
_STOP_TRIES_AT_CLOSE = 2
_CHATTER = 256
"""How many replies are heard before a message is sent all the same."""


class Miss(StrEnum):
    """Why there is no answer."""

    SILENT = "nothing came back"
    GARBLED = "what came back is no answer"
    CUT = "a stop went first"
    VOID = "it was stopped before"


@dataclass(frozen=True, slots=True)
class Answer:
    """What an inquiry brought, and when the head sampled it: ``stamp_s`` plus or minus ``half_window_s``."""

    content: bytes
    stamp_s: float
    half_window_s: float


@dataclass(slots=True)
class _OwedStop:
    """A stop that its head has not acknowledged yet."""

    body: bytes
    due_s: float
    tries: int = _STOP_TRIES


class Line:
    """The line. Open while at least one head is attached to it; any thread may call."""

    def __init__(
        self, open_port: Callable[[], Transport], clock: Clock, *, reply_timeout_s: float, gap_s: float
    ) -> None:
        self.clock = clock
        self._open_port = open_port
        self._reply_timeout_s = reply_timeout_s
        self._gap_s = gap_s
        self._turns = Turns(self._wake)
        self._transport: Transport | None = None
        self._attached: set[tuple[Transport, int]] = set()
        self._owed: dict[int, _OwedStop] = {}
        self._held: dict[int, set[int]] = {}
        self._lasting: dict[int, set[int]] = {}
        """Of those, what the next command leaves alone: a zoom on its way."""
        self._unheard: set[int] = set()
        """Heads that have acknowledged no stop since the last that was sent."""
        self._quiet_from_s = 0.0

    def attach(self, address: int) -> Transport:
        """Open the port where it is not, and keep it open for one head more; raises LinkLost. Sends nothing."""
        with self._turns.turn():
            if self._transport is None:
                self._transport = self._open_port()
                self._unheard |= self._owed.keys()
                self._owed.clear()
                self._held.clear()
                self._lasting.clear()
            self._attached.add((self._transport, address))
            return self._transport

    def detach(self, transport: Transport, address: int) -> None:
        """Let a head go once its stop is out; the last one closes the port. Raises nothing."""
        with suppress(LinkLost):
            while (owed := self._owed.get(address)) is not None:
                owed.tries = min(owed.tries, _STOP_TRIES_AT_CLOSE)
                with self._turn(transport):
                    self._repeat_stop(transport, address)
        with self._turns.turn():
            self._attached.discard((transport, address))
            if not any(other is transport for other, _ in self._attached):
                self._drop(transport)

    def ask(self, transport: Transport, address: int, inquiry: bytes, size: int) -> Answer | Refused | Miss:
        """Put an inquiry, whose answer has ``size`` bytes of content; raises LinkLost."""

        def answers(reply: Reply) -> bool:
            match reply:
                case Completed(content=content):
                    return len(content) == size
                case Refused(socket=socket, code=code):
                    told = (Error.LENGTH, Error.SYNTAX, Error.NOT_EXECUTABLE)
                    return code in told and socket not in self._held.get(address, ())
            return False

        self._serve_owed(transport)
        with self._turn(transport):
            begun_s, heard = self._converse(transport, address, inquiry, answers)
        if isinstance(heard, Miss):
            return heard
        if not isinstance(heard.reply, Completed):
            assert isinstance(heard.reply, Refused)
            return heard.reply
        half_window_s = max(0.0, 0.5 * (heard.start_s - begun_s))
        return Answer(heard.reply.content, begun_s + half_window_s, half_window_s)

    def tell(
        self, transport: Transport, address: int, command: bytes, allowed: Callable[[], bool], *, lasting: bool = False
    ) -> Acknowledged | Completed | Refused | Miss:
        """Give a command if it is still allowed when its turn comes; return what the head says. Raises LinkLost.

        One command of ours is executed at a time: the other socket is kept free for a stop.
        """
        while address in self._owed:  # said again after the command it would end that too
            with self._turn(transport):
                self._repeat_stop(transport, address)
        with self._turn(transport):
            if not allowed():
                return Miss.VOID
            if not self._quiet(transport):
                return Miss.CUT
            is_outcome = self._outcome_of(address)
            kept = self._lasting.setdefault(address, set())
            for socket in sorted(self._held.get(address, set()) - kept):
                transport.send(message(address, cancel(socket)))
            self._held[address] = set(kept)
            _, heard = self._converse(transport, address, command, is_outcome)
            if isinstance(heard, Miss):
                return heard
            if isinstance(heard.reply, Refused) and heard.reply.code == Error.BUFFER_FULL:
                kept.clear()
                self._held[address] = set(SOCKETS)  # by whom we do not know; cancelled before the next command
            if isinstance(heard.reply, Acknowledged):
                (kept.add if lasting else kept.discard)(heard.reply.socket)
            return heard.reply

    def stop_unheard(self, address: int) -> bool:
        """Tell whether the last stop may never have come to the head."""
        return address in self._unheard

    def stop(self, transport: Transport, address: int, body: bytes) -> None:
        """Send stop now, ahead of everything, and owe its repetition; raises LinkLost."""
        with self._turns.stop_turn(), self._current(transport):
            self._unheard.add(address)
            self._lasting.pop(address, None)
            self._owed[address] = _OwedStop(body, self.clock.now_s() + _AGAIN_S)
            for each in (body, *map(cancel, SOCKETS)):
                sent = transport.send(message(address, each))
            self._quiet_from_s = sent.end_s + self._gap_s

    # --- inside -----------------------------------------------------------------------------------------

    def _serve_owed(self, transport: Transport) -> None:
        """Say again every stop that is due."""
        while due := [address for address, owed in list(self._owed.items()) if owed.due_s <= self.clock.now_s()]:
            with self._turn(transport):
                self._repeat_stop(transport, due[0])

    def _repeat_stop(self, transport: Transport, address: int) -> None:
        if (owed := self._owed.get(address)) is None:
            return
        owed.tries -= 1
        _, heard = self._converse(transport, address, owed.body, self._outcome_of(address))
        obeyed = isinstance(heard, Heard) and isinstance(heard.reply, Acknowledged | Completed)
        if self._owed.get(address) is not owed or heard is Miss.CUT:
            return  # another stop went first and is owed in its turn
        if not obeyed and owed.tries > 0:
            owed.due_s = self.clock.now_s() + _AGAIN_S
            self._quiet_from_s = owed.due_s
            return
        if obeyed:
            self._unheard.discard(address)
        else:
            _log.warning("%s: the head at address %d acknowledged no stop", transport.name, address)
        del self._owed[address]

    def _outcome_of(self, address: int) -> Callable[[Reply], bool]:
        """Tell the outcome of the command just given from the end of one before it."""
        before = frozenset(self._held.get(address, ()))

        def is_outcome(reply: Reply) -> bool:
            match reply:
                case Completed(socket=socket, content=content):
                    return not content and socket not in before
                case Refused(code=code):
                    return code not in {Error.CANCELLED, Error.NO_SOCKET}
            return True

        return is_outcome

    def _converse(
        self, transport: Transport, address: int, body: bytes, wanted: Callable[[Reply], bool]
    ) -> tuple[float, Heard | Miss]:
        """Send, and wait for the reply that is wanted; return when the sending ended, too."""
        if not self._quiet(transport):
            return self.clock.now_s(), Miss.CUT
        sent = transport.send(message(address, body))
        deadline_s = sent.end_s + self._reply_timeout_s
        miss = Miss.SILENT
        while (left_s := deadline_s - self.clock.now_s()) > 0.0:
            if self._turns.stop_waits:
                return sent.end_s, Miss.CUT
            for heard in transport.receive(left_s):
                ours = heard.reply.address == address and heard.sequence in {None, sent.sequence}
                in_time = heard.start_s >= sent.end_s - _BAUD_TOLERANCE_S
                found = ours and in_time and wanted(heard.reply)
                self._note(heard.reply)
                if found:
                    self._quiet_from_s = self.clock.now_s() + self._gap_s
                    return sent.end_s, heard
                if ours and isinstance(heard.reply, Completed) and heard.reply.content:
                    miss = Miss.GARBLED
        self._quiet_from_s = deadline_s + self._gap_s
        return sent.end_s, miss

    def _quiet(self, transport: Transport) -> bool:
        """Hear what still comes until the line has been quiet for its gap; False where a stop must go first."""
        for _ in range(_CHATTER):
            left_s = max(0.0, self._quiet_from_s - self.clock.now_s())
            heard = transport.receive(left_s)
            for each in heard:
                self._note(each.reply)
            if self._turns.stop_waits:
                return False
            if not heard and left_s == 0.0:
                break
        return True

    def _note(self, reply: Reply) -> None:
        """Keep the account of the sockets that a head holds for us."""
        held = self._held.setdefault(reply.address, set())
        if isinstance(reply, Acknowledged):
            held.add(reply.socket)
        else:
            held.discard(reply.socket)
            self._lasting.get(reply.address, set()).discard(reply.socket)

    @contextmanager
    def _turn(self, transport: Transport) -> Iterator[None]:
        with self._turns.turn(), self._current(transport):
            yield

    @contextmanager
    def _current(self, transport: Transport) -> Iterator[None]:
        """Work with a port that is still ours; one that is lost is closed for all."""
        if transport is not self._transport:
            raise LinkLost(f"{transport.name} was lost or closed")
        try:
            yield
        except LinkLost:
            self._drop(transport)
            raise

    def _drop(self, transport: Transport) -> None:
        transport.close()
        if self._transport is transport:
            self._transport = None

    def _wake(self) -> None:
        if (transport := self._transport) is not None:
            transport.wake()
