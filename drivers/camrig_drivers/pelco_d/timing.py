"""What an exchange on the line tells about time: when a head sampled what it reports, and how long it takes to answer.

Pure. The head samples between the end of the question and the start of its reply, so that is all that is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from camrig_drivers.pelco_d.codec import Reply

_BAUD_TOLERANCE = 0.03
"""How much faster than its nominal rate a UART may send and still be understood."""
_LEAST_TIMEOUT_S = 0.08
"""Adapters hold bytes back for 16 ms, twice, and a busy host is late too; a needless miss costs more than waiting."""
_MEAN_GAIN, _SPREAD_GAIN, _SPREADS = 0.125, 0.25, 4.0
"""Of RFC 6298, which estimates round trips from their smoothed mean and mean deviation."""
_REPLIES_TO_KNOW = 8


@dataclass(frozen=True, slots=True)
class Answer:
    """A reply, and when the head sampled it: between our frame's end and its own start, ``stamp_s`` +- half that."""

    reply: Reply
    stamp_s: float
    half_window_s: float


class Miss(StrEnum):
    """Why there is no answer."""

    SILENT = "nothing came back"
    GARBLED = "what came back is no answer"
    TOO_SOON = "the answer came sooner than the baud rate allows"
    CUT = "a stop went first"


def timed(reply: Reply, asked_s: float, heard_s: float, reply_s: float) -> Answer | None:
    """Stamp a reply whose last byte came at ``heard_s``; None where it began before the question had ended."""
    window_s = heard_s - reply_s - asked_s
    if window_s < -_BAUD_TOLERANCE * reply_s:
        return None
    half_window_s = max(0.0, 0.5 * window_s)
    return Answer(reply, asked_s + half_window_s, half_window_s)


@dataclass(slots=True)
class ReplyTime:
    """How long one head takes to begin its reply, learnt from its replies; ``most_s`` bounds what is waited for."""

    most_s: float
    mean_s: float = 0.0
    spread_s: float = 0.0
    _known: int = 0

    @property
    def timeout_s(self) -> float:
        """How long to wait for the next reply to begin; the most allowed until enough replies came in a row."""
        if self._known < _REPLIES_TO_KNOW:
            return self.most_s
        return min(self.most_s, max(_LEAST_TIMEOUT_S, self.mean_s + _SPREADS * self.spread_s + 0.5 * _LEAST_TIMEOUT_S))

    def heard(self, answer: Answer) -> None:
        """Learn from a reply."""
        took_s = 2.0 * answer.half_window_s
        if self._known == 0:
            self.mean_s, self.spread_s = took_s, 0.5 * took_s
        else:
            self.spread_s += _SPREAD_GAIN * (abs(took_s - self.mean_s) - self.spread_s)
            self.mean_s += _MEAN_GAIN * (took_s - self.mean_s)
        self._known += 1

    def missed(self) -> None:
        """Wait as long as is allowed again: the head may have become slower."""
        self._known = 0


@dataclass(slots=True)
class LinkStatistics:
    """What came of one head's exchanges since its link was opened."""

    asked: int = 0
    answered: int = 0
    degraded: int = 0
    """Answers without their first bytes, completed from the question."""
    silent: int = 0
    garbled: int = 0
    too_soon: int = 0
    cut: int = 0
    """Questions that a stop cut short."""
    moves: int = 0
    stops: int = 0
    voided: int = 0
    """Motions that were not sent because a stop came before them."""

    def count(self, miss: Miss) -> None:
        """Count a question without an answer."""
        match miss:
            case Miss.SILENT:
                self.silent += 1
            case Miss.GARBLED:
                self.garbled += 1
            case Miss.TOO_SOON:
                self.too_soon += 1
            case Miss.CUT:
                self.cut += 1
