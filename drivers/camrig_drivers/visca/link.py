"""One head's use of its line."""

from __future__ import annotations

from camrig_drivers.visca.codec import Acknowledged, Completed, Refused
from camrig_drivers.visca.line import Answer, Line, Miss

_LATE_S = 0.4
"""How long after its time-out a reply may still come in."""


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

    def ask(self, inquiry: bytes, size: int) -> Answer | Refused | Miss:
        """Put an inquiry and wait for its answer; after a miss first wait until a late answer is past."""
        clock = self._line.clock
        clock.sleep_s(self._ask_again_s - clock.now_s())
        answer = self._line.ask(self.transport, self._address, inquiry, size)
        if isinstance(answer, Miss):
            self._ask_again_s = clock.now_s() + _LATE_S
        return answer

    def tell(self, command: bytes, permit: object) -> Acknowledged | Completed | Refused | Miss:
        """Give a command; VOID where a stop has voided its permit, and then nothing is sent."""
        return self._line.tell(self.transport, self._address, command, lambda: permit is self.permit)

    def stop(self, body: bytes) -> None:
        """Void every permit and send stop, ahead of everything; any thread."""
        self.permit = object()
        self._line.stop(self.transport, self._address, body)

    def close(self) -> None:
        """Let go of the line; twice is allowed."""
        self._line.detach(self.transport, self._address)
