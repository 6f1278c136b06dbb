"""A command that is repeated until somebody sees that it took effect: acks and datagrams get lost."""

from __future__ import annotations

from dataclasses import dataclass, replace

from camrig_drivers.mavlink.packets import Command


@dataclass
class Asking:
    """Sends ``command`` at ``next_s`` and every ``period_s`` after; only for commands that may be repeated."""

    command: Command
    period_s: float
    next_s: float

    def due(self, now_s: float) -> list[Command]:
        """Return the command if it is due; each repetition counts its ``confirmation`` up."""
        if now_s < self.next_s:
            return []
        self.next_s = now_s + self.period_s
        command = self.command
        self.command = replace(command, confirmation=min(command.confirmation + 1, 255))
        return [command]
