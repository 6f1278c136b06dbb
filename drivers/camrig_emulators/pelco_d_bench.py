"""A master for a stepped line: what a driver would write, in simulated time, without thread or port."""

from __future__ import annotations

from collections.abc import Iterator

from camrig.clock import ManualClock
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine


class Bench:
    """A line on a clock of its own. Nothing passes but by ``wait``, ``run`` and ``ask``."""

    def __init__(self, *heads: PelcoDHeadSettings, seed: int = 0, script: str = "") -> None:
        self.clock = ManualClock()
        self.line = PelcoDLine(heads, clock=self.clock, seed=seed, script=script)

    @property
    def now_s(self) -> float:
        return self.clock.now_s()

    def write(self, data: bytes, baud: int | None = None) -> None:
        """Write raw bytes now, through a port set to ``baud`` (by default the line's)."""
        self.line.receive(data, self.now_s, baud or self.line.baud)

    def send(self, address: int, command2: int, value: int = 0, command1: int = 0) -> None:
        """Write one command now."""
        body = bytes((address, command1, command2, value >> 8, value & 0xFF))
        self.write(bytes((0xFF, *body, sum(body) & 0xFF)))

    def run(self, duration_s: float, baud: int | None = None) -> Iterator[tuple[float, bytes]]:
        """Let time pass; yield what arrives at a port set to ``baud``, and when."""
        until_s = self.now_s + duration_s
        while (next_s := self.line.next_s()) is not None and next_s <= until_s:
            self.clock.advance(next_s - self.now_s)
            if data := self.line.transmit(self.now_s, baud or self.line.baud):
                yield self.now_s, data
        self.clock.advance(until_s - self.now_s)

    def wait(self, duration_s: float) -> bytes:
        """Let time pass; return what arrived."""
        return b"".join(data for _, data in self.run(duration_s))

    def ask(self, address: int, opcode: int, within_s: float = 0.5) -> bytes:
        """Send a command without data, let ``within_s`` pass, and return what arrived."""
        self.send(address, opcode)
        return self.wait(within_s)
