"""The threads that serve devices, one each: open, work, and come back when a link is lost."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from camrig.clock import Clock
from camrig.errors import CamrigError, EndOfInput, LinkLoss, LinkLost
from camrig.messages import LinkReport, LinkStatus
from camrig.runtime.mailbox import Mailbox

log = logging.getLogger(__name__)

FIRST_RETRY_S = 0.2
LAST_RETRY_S = 5.0
LENT = "lent to another program"
_LENT_LOOK_S = 0.1


class Job(Protocol):
    """What one worker does with its device; all methods but ``wake`` are called by the worker's thread."""

    @property
    def name(self) -> str:
        """The device's id."""
        ...

    def open(self) -> None:
        """Open the device; raises LinkLost."""
        ...

    def turn(self) -> None:
        """Do one bounded piece of work, well under a second; raises LinkLost, EndOfInput."""
        ...

    def close(self) -> None:
        """Release the device; twice is allowed."""
        ...

    def wake(self) -> None:
        """Make a blocked ``turn`` return soon; any thread."""
        ...


@dataclass
class Worker:
    """Runs a job in a thread named after its device; ``failed`` holds the exception that is a bug."""

    job: Job
    clock: Clock
    links: Mailbox[LinkReport]
    on_failure: Callable[[], None]
    failed: BaseException | None = None
    ended: bool = False
    """The device's input has ended for good (a recording)."""
    losses: int = 0
    """How often the link was lost once it had been up."""
    beat_s: float = field(init=False)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _lent_until_s: float = -math.inf
    _thread: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.beat_s = self.clock.now_s()
        self._thread = threading.Thread(target=self._run, name=self.job.name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def request_stop(self) -> None:
        """Ask the thread to end; any thread."""
        self._stopping.set()
        self.job.wake()

    def lend(self, until_s: float) -> None:
        """Let go of the device until then, for another program, and open it again afterwards; any thread."""
        self._lent_until_s = until_s
        self.job.wake()

    @property
    def lent(self) -> bool:
        """Whether another program has the device now; any thread."""
        return self.clock.now_s() < self._lent_until_s

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread; return whether it has ended."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            try:
                self._serve()
            finally:
                self.job.close()
        except EndOfInput:
            self._report(LinkStatus.CLOSED, "end of input")
            self.ended = True
        except BaseException as error:  # whatever it is, the rig must come to rest and exit
            log_failure(log, self.job.name, error)
            self.failed = error
            self.on_failure()

    def _serve(self) -> None:
        retry_s, was_up = FIRST_RETRY_S, False
        while not self._stopping.is_set():
            try:
                self._beat()
                if self.lent:
                    self._wait_for_it()
                    continue
                self.job.open()
                self._report(LinkStatus.UP, "")
                retry_s, was_up = FIRST_RETRY_S, True
                while not (self._stopping.is_set() or self.lent):
                    self._beat()
                    self.job.turn()
            except LinkLost as error:
                self.job.close()
                self._report(LinkStatus.LOST, str(error), error.loss)
                self.losses += was_up
                was_up = False
                self._beat()
                self._stopping.wait(retry_s)
                retry_s = min(2.0 * retry_s, LAST_RETRY_S)
        self._report(LinkStatus.CLOSED, "stopped")

    def _wait_for_it(self) -> None:
        """Do without the device while it is lent."""
        self.job.close()
        self._report(LinkStatus.CLOSED, LENT)
        while self.lent and not self._stopping.wait(_LENT_LOOK_S):
            self._beat()

    def _beat(self) -> None:
        self.beat_s = self.clock.now_s()

    def _report(self, status: LinkStatus, reason: str, loss: LinkLoss | None = None) -> None:
        self.links.put(LinkReport(self.job.name, status, self.clock.now_s(), reason, loss))


def log_failure(logger: logging.Logger, name: str, error: BaseException) -> None:
    """Log what ended a thread: a sentence where it is one for the user, with its traceback where it is a bug."""
    if isinstance(error, CamrigError):
        logger.error("%s: %s", name, error, extra={"device": name})
    else:
        logger.error("%s: unexpected failure", name, exc_info=error, extra={"device": name})
