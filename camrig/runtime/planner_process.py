"""The planner in a process of its own, so that a solve delays no frame stamp, no command and no stop."""

from __future__ import annotations

import signal
import sys
import time
from multiprocessing.connection import Connection

from camrig import optimise
from camrig.messages import PlannerAnswer, PlannerRequest, PlanRequest
from camrig.optimise import PlannerSettings
from camrig.rig import Rig


def serve(connection: Connection) -> None:
    """Answer requests one after the other until the daemon's end closes."""
    rig: Rig
    settings: PlannerSettings
    try:
        rig, settings = connection.recv()
        while True:
            connection.send(_answer(rig, settings, connection.recv()))
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _answer(rig: Rig, settings: PlannerSettings, request: PlannerRequest) -> PlannerAnswer:
    if isinstance(request, PlanRequest):
        return optimise.plan_for(rig, request, settings, time.monotonic)
    return optimise.scan_for(rig, request, settings, time.monotonic)


if __name__ == "__main__":
    for ignored in (signal.SIGINT, signal.SIGTERM):  # sent to the whole service; the daemon says when it is over
        signal.signal(ignored, signal.SIG_IGN)
    serve(Connection(int(sys.argv[1])))
