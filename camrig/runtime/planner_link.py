"""The planner's process, seen from the control thread: hand over a request, look whether an answer has come."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError
from camrig.messages import PlannerAnswer, PlannerRequest
from camrig.optimise import PlannerSettings
from camrig.rig import Rig

log = logging.getLogger(__name__)

_EXIT_TIMEOUT_S = 0.5
_DEATHS_ALLOWED = 2
"""Over one request. A process may be killed by the system; one that dies again and again has a bug."""
ANSWER_LIMIT_S = 300.0
"""A planner that owes an answer for longer hangs, and is killed. The first one may compile kernels for minutes."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass
class PlannerLink:
    """Owns the planner's process (runtime.planner_process); nothing here blocks but ``close``."""

    rig: Rig
    settings: PlannerSettings
    clock: Clock = field(default_factory=RealClock)
    _process: subprocess.Popen[bytes] = field(init=False)
    _connection: Connection = field(init=False)
    _owed: PlannerRequest | None = None
    _asked_s: float = 0.0
    _deaths: int = 0

    def __post_init__(self) -> None:
        self._start()

    @property
    def idle(self) -> bool:
        """Whether a request would be taken at once."""
        return self._owed is None

    def submit(self, request: PlannerRequest) -> None:
        """Hand over a request; only while ``idle``. A planner that has died is started again."""
        if self._owed is not None:
            raise RuntimeError("the planner still owes an answer; submit only while it is idle")
        self._owed, self._asked_s = request, self.clock.now_s()
        try:
            self._connection.send(request)
        except OSError:
            self._restart()

    def poll(self) -> PlannerAnswer | None:
        """Return the answer if it has come. A planner that died is started again and given its request again, so that
        every request is answered; raises HardwareError where one request kills it again and again.
        """
        if self._owed is None:
            return None
        try:
            if not self._connection.poll():
                self._kill_if_hung()
                return None
            answer: PlannerAnswer = self._connection.recv()
        except (EOFError, OSError):
            self._restart()
            return None
        self._owed, self._deaths = None, 0
        return answer

    def close(self) -> None:
        """End the planner's process at once, whatever it is doing: it holds nothing; twice is allowed."""
        self._connection.close()
        self._process.kill()
        self._process.wait()

    def _kill_if_hung(self) -> None:
        if self.clock.now_s() > self._asked_s + ANSWER_LIMIT_S:
            log.warning("the planner has not answered for %.0f s: its process is killed", ANSWER_LIMIT_S)
            self._asked_s = self.clock.now_s()
            self._process.kill()  # the next poll finds it dead

    def _restart(self) -> None:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_TIMEOUT_S)  # it is ending by itself, and its exit code says why
        self.close()
        self._deaths += 1
        died = f"the planner's process died (exit code {self._process.returncode})"
        if self._deaths > _DEATHS_ALLOWED:
            raise HardwareError(f"{died} {self._deaths} times over one request; what it said stands above in the log")
        log.warning("%s and is started again", died)
        self._start()
        self._connection.send(self._owed)

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "camrig.runtime.planner_process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, **_ONE_THREAD},
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._connection.send((self.rig, self.settings))
