"""``world: {driver: emulated}``: an emulated rig in a process of its own, behind the World protocol."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, InputError
from camrig.geometry.arrays import Transform
from camrig.interfaces import World, WorldPlugin
from camrig.rig import Rig
from camrig_emulators import world_settings
from camrig_emulators.robots import RobotLimits, plan_motions, poses
from camrig_emulators.scenery import Scenery
from camrig_emulators.world_faults import WorldFaults
from camrig_emulators.world_section import WorldSection
from camrig_emulators.world_wire import AskCameraPose, Failed, Job, Ready, Request, SetFault, Stop

_START_TIMEOUT_S = 30.0
_ANSWER_TIMEOUT_S = 5.0
_STOP_TIMEOUT_S = 5.0


class EmulatedWorld:
    """A ``World``. Everything may be called from any thread; ``truth`` and ``elapsed_s`` go on after ``stop``."""

    def __init__(
        self, rig: Rig, section: WorldSection, devices: Mapping[str, Mapping[str, Any]], clock: Clock | None = None
    ) -> None:
        """Plan the robots' routes and check what shall be emulated; raises InputError, starts nothing."""
        self._rig = rig
        self._section = section
        self._devices = {name: dict(raw) for name, raw in devices.items()}
        self._clock = RealClock() if clock is None else clock
        limits = RobotLimits(section.robot_margin_m, section.robot_speed_m_s)
        self._motions = plan_motions(rig.targets, rig.space, limits, section.seed)
        Scenery(rig, self._motions)
        world_settings.head_lines(rig, section, self._devices)
        world_settings.drones(rig, section, self._devices)
        world_settings.rendered_cameras(rig, self._devices)
        self._lock = threading.Lock()
        self._process: _Process | None = None
        self._ready: Ready | None = None

    def start(self) -> Mapping[str, str]:
        with self._lock:
            if self._process is None:
                process = _Process()
                try:
                    job = Job(self._rig, self._section, self._devices, self._motions, process.folder)
                    ready = process.ask(job, _START_TIMEOUT_S)
                except BaseException:
                    process.end()
                    raise
                if not isinstance(ready, Ready):
                    raise TypeError(f"the world answered {ready!r} to its job")
                self._process, self._ready = process, ready
            return dict(self._ready.ports) if self._ready else {}

    def truth(self, stamp_s: float) -> Mapping[str, Transform]:
        return poses(self._motions, self.elapsed_s(stamp_s))

    def elapsed_s(self, stamp_s: float) -> float:
        if self._ready is None:
            raise HardwareError("the emulated world has no time before it is started")
        return stamp_s - self._ready.epoch_s + self._section.start_s

    def camera_pose(self, camera_id: str, stamp_s: float) -> Transform:
        """Return the true ``T_world_camera`` of a camera at a stamp of the last 20 s."""
        return np.asarray(self._ask(AskCameraPose(camera_id, stamp_s)), dtype=float)

    def faults(self, device_id: str) -> WorldFaults:
        """Return the faults of one head, drone or rendered camera; unplugging a head unplugs its whole line."""

        def set_fault(fault: SetFault) -> None:
            self._ask(fault)

        return WorldFaults(device_id, set_fault)

    def stop(self) -> None:
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.end()

    def _ask(self, request: Request) -> object:
        with self._lock:
            if self._process is None:
                raise HardwareError("the emulated world is not running")
            return self._process.ask(request, _ANSWER_TIMEOUT_S)


class _Process:
    """The world's process, its folder and our end of the line to it."""

    def __init__(self) -> None:
        self.folder = tempfile.mkdtemp(prefix="camrig-world-")
        self._line: Connection[Any, Any]
        self._line, theirs = Pipe()
        with theirs:
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-m", "camrig_emulators.world_process", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                # What the devices put into a temporary folder goes with ours, however the process ends.
                env={**os.environ, "TMPDIR": self.folder},
                start_new_session=True,
            )

    def ask(self, message: object, timeout_s: float) -> object:
        """Send a message and return its answer; raises HardwareError for a world that is gone or does not answer."""
        try:
            self._line.send(message)
            if not self._line.poll(timeout_s):
                self._line.close()  # its answer, come late, would be taken for that of the next question
                raise HardwareError(f"the emulated world did not answer within {timeout_s:g} s; start it again")
            answer: object = self._line.recv()
        except (EOFError, OSError) as error:
            raise HardwareError("the emulated world's process has ended; its standard error says why") from error
        if isinstance(answer, Failed):
            raise (InputError if answer.input_error else HardwareError)(answer.text)
        return answer

    def end(self) -> None:
        """Ask the process to stop, insist if it does not, and clear up."""
        with contextlib.suppress(OSError):
            self._line.send(Stop())
        try:
            self._child.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._line.close()
        shutil.rmtree(self.folder, ignore_errors=True)


def _make(rig: Rig, section: WorldSection, devices: Mapping[str, Mapping[str, Any]]) -> World:
    return EmulatedWorld(rig, section, devices)


driver = WorldPlugin(section=WorldSection, make=_make)
