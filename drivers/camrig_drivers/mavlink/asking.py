"""Commands that are repeated until somebody sees that they took effect: acks and datagrams get lost."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from camrig_drivers.mavlink.packets import Command, CommandAck

_IN_PROGRESS = 5
_PERIOD_S = 1.0
_TRIES = 3
"""PX4 without a gimbal never answers a gimbal's command: nothing is asked for ever."""


@dataclass
class Asking:
    """Sends ``command`` at ``next_s`` and every ``period_s`` after; only for commands that may be repeated."""

    command: Command
    period_s: float
    next_s: float
    asked: int = 0

    def due(self, now_s: float) -> list[Command]:
        """Return the command if it is due; each repetition counts its ``confirmation`` up."""
        if now_s < self.next_s:
            return []
        self.next_s = now_s + self.period_s
        self.asked += 1
        command = self.command
        self.command = replace(command, confirmation=min(command.confirmation + 1, 255))
        return [command]


class Errands:
    """Commands that only need an answer, one after the other; who does not answer a few times is not asked again."""

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque()
        self._asking: Asking | None = None
        self.refused: dict[int, str] = {}
        """Why a command came to nothing the last time, by its number."""

    def add(self, *commands: Command) -> None:
        """Put commands at the end, in place of those of the same number that still wait."""
        numbers = {command.command for command in commands}
        self._waiting = deque(command for command in self._waiting if command.command not in numbers)
        self._waiting += commands

    def clear(self) -> None:
        """Forget all of them."""
        self._waiting.clear()
        self._asking = None

    def hear(self, ack: CommandAck) -> None:
        """Take an answer."""
        asking = self._asking
        if asking is None or ack.command != asking.command.command or not ack.is_for_us or ack.result == _IN_PROGRESS:
            return
        self._asking = None
        if ack.result:
            self.refused[ack.command] = f"refused with result {ack.result}"
        else:
            self.refused.pop(ack.command, None)

    def due(self, now_s: float) -> list[Command]:
        """Return what to send now."""
        asking = self._asking
        if asking is not None and asking.asked >= _TRIES and now_s >= asking.next_s:
            self.refused[asking.command.command] = "not answered"
            self._asking = asking = None
        if asking is None and self._waiting:
            self._asking = asking = Asking(self._waiting.popleft(), _PERIOD_S, now_s)
        return asking.due(now_s) if asking is not None else []
