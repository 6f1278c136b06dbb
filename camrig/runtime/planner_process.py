"""The planner in a process of its own, so that a solve delays no frame stamp, no command and no stop."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection

from camrig import optimise
from camrig.messages import Aim, PlanRequest
from camrig.optimise import PlannerSettings
from camrig.rig import Rig

_LONG_S = 1e9
_PROPOSED_EVERY = 5
"""Requests: detection needs the processors too, and what is far better than the present rig stays so for a while."""
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_NICE = 10
"""A plan may be late; a frame must not be."""


def serve(connection: Connection) -> None:
    """Answer requests one after the other until the daemon's end closes.

    A plan is answered at once, from about the running aims. Now and then a thorough search looks, at most for a
    request's deadline and until the next request comes, for something better to propose to the next plans.
    """
    rig: Rig
    settings: PlannerSettings
    proposals: tuple[Mapping[str, Aim], ...] = ()
    try:
        rig, settings = connection.recv()
        optimise.warm_up(settings)
        while True:
            request = connection.recv()
            if isinstance(request, PlanRequest):
                connection.send(optimise.plan_for(rig, request, settings, time.monotonic, proposals))
                if request.request_id % _PROPOSED_EVERY == 0:
                    proposals = (optimise.proposal_for(rig, request, settings, _until_asked(connection)),)
            else:
                connection.send(optimise.scan_for(rig, request, settings, time.monotonic))
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _until_asked(connection: Connection) -> Callable[[], float]:
    """Return a clock on which every deadline has passed as soon as there is something to answer."""
    return lambda: time.monotonic() + (_LONG_S if connection.poll() else 0.0)


def _end_with_the_daemon() -> None:
    """Have the kernel kill this process when the daemon dies, whatever it is computing: systemd would wait for it, up
    to TimeoutStopSec, before it has the heads stopped once more and the daemon started again.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    _end_with_the_daemon()
    for ignored in (
        signal.SIGINT,
        signal.SIGTERM,
        signal.SIGHUP,
    ):  # sent to the whole service; the daemon says when it is over
        signal.signal(ignored, signal.SIG_IGN)
    os.nice(_NICE)
    serve(Connection(int(sys.argv[1])))
