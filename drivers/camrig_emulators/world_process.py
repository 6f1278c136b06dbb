"""The process in which the emulated world runs: ``python -m camrig_emulators.world_process DESCRIPTOR``.

Drawing shares no interpreter lock with the daemon, and the emulated devices outlive a killed daemon for as long as it
takes to stop them from outside. It serves its parent's end of a socket pair and ends when that is closed.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
import traceback
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import Any

import cv2

from camrig.clock import RealClock
from camrig.errors import CamrigError, InputError
from camrig_emulators.stage import Stage
from camrig_emulators.world_wire import AskCameraPose, Failed, Job, Request, SetFault, Stop

_PARENT_CHECK_S = 0.2
_LINGER_S = 0.3
"""How long the devices stay after the parent's death: the guardian's stop must still find its port."""
_SWITCH_INTERVAL_S = 0.001


def serve(parent: Connection[Any, Any]) -> None:
    """Run the world that the first message describes until the parent says stop or is gone; then clear up."""
    job: Job = parent.recv()
    with ExitStack() as running:
        running.callback(shutil.rmtree, job.folder, ignore_errors=True)
        try:
            stage = Stage(job, RealClock())
            running.callback(stage.stop)
            parent.send(stage.start())
            _obey(parent, stage)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            time.sleep(_LINGER_S)
        except (CamrigError, OSError) as error:
            parent.send(_failed(error))


def main(descriptor: int) -> int:
    """Serve the given end of the socket pair; the process belongs to the world alone."""
    cv2.setNumThreads(1)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    threading.excepthook = _die
    for number in (signal.SIGINT, signal.SIGTERM):  # a rig is stopped by its daemon, and its world by the rig's end
        signal.signal(number, signal.SIG_IGN)
    parent: Connection[Any, Any] = Connection(descriptor)
    with parent:
        serve(parent)
    return 0


def _obey(parent: Connection[Any, Any], stage: Stage) -> None:
    """Answer requests until Stop; raises EOFError when the parent is gone."""
    parent_pid = os.getppid()
    while True:
        if not parent.poll(_PARENT_CHECK_S):
            if os.getppid() != parent_pid:
                raise EOFError
            continue
        request: Request = parent.recv()
        if isinstance(request, Stop):
            return
        parent.send(_answer(stage, request))


def _answer(stage: Stage, request: SetFault | AskCameraPose) -> object:
    try:
        if isinstance(request, SetFault):
            stage.set_fault(request)
            return None
        return stage.camera_pose(request.camera_id, request.stamp_s)
    except (CamrigError, ValueError) as error:
        return _failed(error)


def _failed(error: Exception) -> Failed:
    return Failed(str(error), input_error=isinstance(error, InputError | ValueError))


def _die(failure: threading.ExceptHookArgs) -> None:
    """End the whole process when a thread fails: half a world is worse than a lost one."""
    traceback.print_exception(failure.exc_type, failure.exc_value, failure.exc_traceback)
    os._exit(70)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
