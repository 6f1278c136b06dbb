"""A pan-tilt head inside a USB camera: it takes absolute positions as V4L2 controls, and its camera may stream.

The kernel lets a device be opened twice: whoever streams holds its buffers, and controls are for everybody. A control
says neither that a motion has ended nor, on most devices, how far it is. There is no stop either: a head is stopped by
being sent to where it is, or, where it does not tell, to where it must be by now; and a dead daemon's head finishes the
move that it was given, which no guardian could end.
"""

from __future__ import annotations

import errno
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from camrig.clock import Clock
from camrig.errors import HardwareError, InputError, LinkLoss, LinkLost, NotEnabledError
from camrig.interfaces import Guard
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.uvc.device import Angles, Device, open_device
from camrig_drivers.uvc.section import UvcSection
from camrig_drivers.v4l2.finder import Finder
from camrig_drivers.v4l2.port import IoctlPort
from camrig_drivers.v4l2.trouble import explain

_NO_ANSWER = (errno.ETIMEDOUT, errno.EPIPE, errno.EAGAIN)
_MISSES_TO_LOSE = 4


@dataclass(frozen=True, slots=True)
class _Move:
    """The last move: from where, to where, and when it began."""

    start_rad: Angles
    target_rad: Angles
    stamp_s: float

    def duration_s(self, speed_rad_s: float) -> float:
        """Return how long it takes, both axes moving at once."""
        return max(abs(b - a) for a, b in zip(self.start_rad, self.target_rad, strict=True)) / speed_rad_s

    def at(self, stamp_s: float, speed_rad_s: float) -> Angles:
        """Return where the head must be at a stamp, if it is as fast as it is said to be."""
        way_rad = max(0.0, stamp_s - self.stamp_s) * speed_rad_s
        pan, tilt = (
            a + math.copysign(min(abs(b - a), way_rad), b - a)
            for a, b in zip(self.start_rad, self.target_rad, strict=True)
        )
        return pan, tilt


class UvcHead:
    """``camrig.interfaces.Head``. One worker thread uses it; ``stop`` may be called from any."""

    def __init__(self, spec: HeadSpec, section: UvcSection, clock: Clock, port: IoctlPort) -> None:
        self._spec = spec
        self._section = section
        self._clock = clock
        self._label = f"head {spec.id}: {section.device}"
        self._finder = Finder(port, section.device, self._label)
        self._tried = False
        self._lock = threading.RLock()
        """Guards what is set on the device: nothing comes between a motion's permit and its controls."""
        self._device: Device | None = None
        self._permit: object | None = None
        self._unstopped = False
        """Whether a motion may have been sent since the last stop that was."""
        self._move: _Move | None = None
        self._zoomed: object | None = None
        """The permit under which the zoom was set."""
        self._misses = 0
        self._next_read_s = -math.inf

    def open(self) -> None:
        """Open the device beside whoever streams from it, and look at its controls; moves nothing, but ends a motion
        that a lost link may have left. Raises HardwareError where it cannot do what the rig's limits ask; later than at
        the first open that is a LinkLost, since a rig is at work and the right device may come back.
        """
        if self._device is not None:
            return
        device = self._found()
        try:
            with self._explained():
                held_rad = device.angles_rad()
            self._misses = 0
            if not self._goes_on(device, held_rad):
                self._move = None
            if self._unstopped:
                self._stop(device)
        except BaseException:
            device.node.close()
            raise
        self._device = device

    def enable(self) -> None:
        self._opened()
        self._permit = object()

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        device = self._opened()
        try:
            values = (device.pan.value(pan_rad), device.tilt.value(tilt_rad))
        except InputError as error:
            raise InputError(f"head {self._spec.id} is not moved: {error}") from error
        with self._lock, self._explained():
            if self._permit is None:
                raise NotEnabledError(f"head {self._spec.id} is not enabled; enable it before moving it")
            self._unstopped = True
            if device.zoom is not None and self._section.zoom is not None and self._zoomed is not self._permit:
                device.node.set_value(device.zoom, self._section.zoom)
                self._zoomed = self._permit
            start_rad = self._where(device)
            device.send(values)
            self._move = _Move(start_rad, (pan_rad, tilt_rad), self._clock.now_s())

    def read(self, timeout_s: float) -> tuple[AxisReading, ...]:
        device = self._opened()
        self._clock.sleep_s(min(timeout_s, self._next_read_s - self._clock.now_s()))
        begun_s = self._clock.now_s()
        self._next_read_s = begun_s + self._section.poll_s
        try:
            angles_rad = device.angles_rad()
        except OSError as error:
            self._missed(error)
            return ()
        self._misses = 0
        ended_s = self._clock.now_s()
        if self._section.reports == "target" and self._on_its_way(ended_s):
            return ()
        return tuple(
            AxisReading(
                head_id=self._spec.id,
                axis=axis.name,
                angle_rad=angle_rad,
                stamp_s=0.5 * (begun_s + ended_s),
                sigma_rad=axis.sigma_rad,
                stamp_sigma_s=0.5 * (ended_s - begun_s) / math.sqrt(3.0),  # uniform over the window
            )
            for axis, angle_rad in zip(device.axes, angles_rad, strict=True)
        )

    def stop(self) -> None:
        self._permit = None
        if (device := self._device) is not None:
            with suppress(LinkLost):
                self._stop(device)

    def guard(self) -> Guard:
        self._opened()
        return Guard(-1, b"")  # a move ends by itself, and a guardian writes no controls

    def close(self) -> None:
        if (device := self._device) is None:
            return
        if self._permit is not None or self._unstopped:
            self.stop()
        with self._lock:
            self._device = None
            device.node.close()

    # --- inside -----------------------------------------------------------------------------------------

    def _found(self) -> Device:
        first, self._tried = not self._tried, True
        try:
            with self._explained():
                return open_device(self._finder, self._label, self._spec, self._section)
        except LinkLost:
            raise
        except HardwareError as error:
            if first:
                raise
            raise LinkLost(str(error), LinkLoss.CHANGED) from error

    def _stop(self, device: Device) -> None:
        with self._lock, self._explained():
            if device is not self._device and self._device is not None:
                return
            device.halt()
            if self._section.reports == "position" or self._on_its_way(self._clock.now_s()):
                here_rad = self._where(device)  # a stop must not move it, not even into its limits
                device.send((device.pan.nearest(here_rad[0]), device.tilt.nearest(here_rad[1])))
                self._move = _Move(here_rad, here_rad, self._clock.now_s())
            self._unstopped = False

    def _where(self, device: Device) -> Angles:
        """Return where the head is, as well as that is known."""
        if self._section.reports == "target" and self._move is not None:
            return self._move.at(self._clock.now_s(), self._spec.speed_rad_s)
        return device.angles_rad()

    def _goes_on(self, device: Device, held_rad: Angles) -> bool:
        """Tell whether a head that was lost on its way may still be on it: without power it would have forgotten."""
        move = self._move
        if move is None or not self._on_its_way(self._clock.now_s()):
            return False
        both = zip(device.axes, held_rad, move.target_rad, strict=True)
        return all(abs(held - target) <= axis.step_rad for axis, held, target in both)

    def _on_its_way(self, now_s: float) -> bool:
        move = self._move
        return (
            move is not None and now_s < move.stamp_s + move.duration_s(self._spec.speed_rad_s) + self._section.settle_s
        )

    def _opened(self) -> Device:
        if self._device is None:
            raise LinkLost(f"head {self._spec.id} is not open; open it first")
        return self._device

    def _missed(self, error: OSError) -> None:
        self._misses += 1
        if error.errno not in _NO_ANSWER or self._misses >= _MISSES_TO_LOSE:
            raise explain(self._label, self._section.device, error) from error

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise explain(self._label, self._section.device, error) from error
