"""The planner's process, seen from the control thread: hand over a request, look whether an answer has come."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from camrig.messages import PlannerAnswer, PlannerRequest
from camrig.optimise import PlannerSettings
from camrig.rig import Rig

_EXIT_TIMEOUT_S = 2.0
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass
class PlannerLink:
    """Owns the planner's process (runtime.planner_process); nothing here blocks but ``close``."""

    rig: Rig
    settings: PlannerSettings
    _process: subprocess.Popen[bytes] = field(init=False)
    _connection: Connection = field(init=False)
    _busy: bool = False

    def __post_init__(self) -> None:
        self._start()

    @property
    def idle(self) -> bool:
        """Whether a request would be taken at once."""
        return not self._busy

    def submit(self, request: PlannerRequest) -> None:
        """Hand over a request; only while ``idle``."""
        self._busy = True
        self._connection.send(request)

    def poll(self) -> PlannerAnswer | None:
        """Return the answer if it has come; a planner that died is started again and its request dropped."""
        try:
            if not self._busy or not self._connection.poll():
                return None
            answer: PlannerAnswer = self._connection.recv()
        except (EOFError, OSError):
            self.close()
            self._start()
            return None
        self._busy = False
        return answer

    def close(self) -> None:
        """End the planner's process; twice is allowed."""
        self._connection.close()
        try:
            self._process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "camrig.runtime.planner_process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, **_ONE_THREAD},
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._busy = False
        self._connection.send((self.rig, self.settings))
