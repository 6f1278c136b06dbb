"""One head's use of its line."""

from __future__ import annotations

from dataclasses import dataclass

from camrig_drivers.visca.codec import Acknowledged, Completed, Refused
from camrig_drivers.visca.line import Answer, Line, Miss

_LATE_S = 0.4
"""How long after its time-out a reply may still come in."""


@dataclass(slots=True)
class LinkStatistics:
    """What came of one head's exchanges since its link was opened."""

    asked: int = 0
    answered: int = 0
    silent: int = 0
    garbled: int = 0
    refused: int = 0
    """Inquiries and commands that the head did not want."""
    cut: int = 0
    """Exchanges that a stop cut short."""
    moves: int = 0
    """Commands given, stops left out."""
    stops: int = 0
    voided: int = 0
    """Commands that were not given because a stop came before them."""

    def count(self, outcome: object) -> None:
        """Count what became of an exchange."""
        match outcome:
            case Refused():
                self.refused += 1
            case Miss.SILENT:
                self.silent += 1
            case Miss.GARBLED:
                self.garbled += 1
            case Miss.CUT:
                self.cut += 1
            case Miss.VOID:
                self.voided += 1


class Link:
    """One head's use of the line, from attaching to closing. Everything but ``close`` may raise LinkLost."""

    def __init__(self, line: Line, address: int) -> None:
        """Open the line where it is not; raises LinkLost. Sends nothing."""
        self.transport = line.attach(address)
        self.permit = object()
        """What a motion must show to be sent; every stop makes a new one, and old ones are void."""
        self._line = line
        self._address = address
        self._ask_again_s = 0.0
        self.statistics = LinkStatistics()

    def ask(self, inquiry: bytes, size: int) -> Answer | Refused | Miss:
        """Put an inquiry and wait for its answer; after a miss first wait until a late answer is past."""
        clock = self._line.clock
        clock.sleep_s(self._ask_again_s - clock.now_s())
        answer = self._line.ask(self.transport, self._address, inquiry, size)
        self.statistics.asked += 1
        self.statistics.answered += isinstance(answer, Answer)
        self.statistics.count(answer)
        if isinstance(answer, Miss):
            self._ask_again_s = clock.now_s() + _LATE_S
        return answer

    def tell(
        self, command: bytes, permit: object, *, lasting: bool = False
    ) -> Acknowledged | Completed | Refused | Miss:
        """Give a command; VOID where a stop has voided its permit, and then nothing is sent."""
        outcome = self._line.tell(
            self.transport, self._address, command, lambda: permit is self.permit, lasting=lasting
        )
        self.statistics.moves += outcome is not Miss.VOID
        self.statistics.count(outcome)
        return outcome

    @property
    def stop_unheard(self) -> bool:
        """Whether the last stop, of this link or one before, may never have come to the head."""
        return self._line.stop_unheard(self._address)

    def stop(self, body: bytes) -> None:
        """Void every permit and send stop, ahead of everything; any thread."""
        self.permit = object()
        self.statistics.stops += 1
        self._line.stop(self.transport, self._address, body)

    def close(self) -> None:
        """Let go of the line; twice is allowed."""
        self._line.detach(self.transport, self._address)
