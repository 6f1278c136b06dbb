"""A camera on a V4L2 device."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError, LinkLoss, LinkLost
from camrig.interfaces import Camera
from camrig.messages import Frame
from camrig.rig import CameraSpec
from camrig_drivers.v4l2.controls import set_controls
from camrig_drivers.v4l2.exposure import Exposure
from camrig_drivers.v4l2.finder import Finder
from camrig_drivers.v4l2.locks import Locks, exposure_time_s
from camrig_drivers.v4l2.negotiation import Agreement, negotiate
from camrig_drivers.v4l2.node import Filled, Node
from camrig_drivers.v4l2.port import IoctlPort, KernelPort
from camrig_drivers.v4l2.section import V4l2Section
from camrig_drivers.v4l2.stamps import mid_exposure
from camrig_drivers.v4l2.stream import Counters, Stream
from camrig_drivers.v4l2.trouble import explain
from camrig_drivers.v4l2.waker import Waker

_log = logging.getLogger(__name__)

START_S = 4.0
"""What a device may take to its first picture; some take seconds to power up. Less than a worker has to end."""
_STALL_PERIODS = 10.0


class V4l2Camera:
    """A ``Camera``; ``wake`` may be called from any thread, all else from one.

    Every ``open`` finds the device under whatever number it has now, and sets and reads back the format, the rate and
    all controls: a camera that was unplugged has forgotten them. ``counters`` tells what became of the frames,
    ``agreement`` what was asked of the device and what it gave.
    """

    def __init__(self, spec: CameraSpec, section: V4l2Section, clock: Clock, port: IoctlPort) -> None:
        self.counters = Counters()
        self.agreement: Agreement | None = None
        self._spec = spec
        self._section = section
        self._clock = clock
        self._port = port
        self._label = f"camera {spec.id}: {section.device}"
        self._waker = Waker()
        self._finder = Finder(port, section.device, self._label)
        self._locks = Locks((*section.lock, "exposure", "gain") if section.exposure else section.lock)
        self._node: Node | None = None
        self._stream: Stream | None = None
        self._exposure: Exposure | None = None
        self._exposure_s: float | None = None
        self._stall_s = section.stall_s
        self._due_s = 0.0
        self._tried = False
        self._doubted = False

    def open(self) -> None:
        """Set everything and start streaming; see ``camrig.interfaces.Camera``.

        HardwareError: no camera, another format or size than asked, a control unknown, out of range or refused; later
        than at the first open it is a LinkLost, since a rig is at work and the right camera may come back. LinkLost:
        all that may pass. After trouble it also waits for a good picture: what opens and delivers nothing is not back.
        """
        self.close()
        self.counters = Counters()
        first, self._tried = not self._tried, True
        with ExitStack() as undo:
            undo.callback(self.close)
            try:
                with self._explained():
                    stream = self._open()
                    if self._doubted and self._next(stream, self._due_s) is None:
                        raise self._stalled()
            except LinkLost:
                raise
            except HardwareError as error:
                if first:
                    raise
                raise LinkLost(str(error), LinkLoss.CHANGED) from error
            undo.pop_all()
        self._doubted = False

    def read(self, timeout_s: float) -> Frame | None:
        """Return the newest frame; see ``camrig.interfaces.Camera``. Damaged frames are dropped and counted."""
        if self._stream is None:
            raise LinkLost(f"{self._label} is not open")
        try:
            with self._explained():
                return self._next(self._stream, self._clock.now_s() + timeout_s)
        except LinkLost:
            self._doubted = True
            raise

    def wake(self) -> None:
        """Make ``read``, now or the next, return None."""
        self._waker.wake()

    def close(self) -> None:
        """Stop streaming and let go of the device; twice is allowed."""
        stream, node = self._stream, self._node
        self._stream = self._node = self._exposure = None
        if stream is not None:
            stream.close()
            _log.info("%s closed: %s", self._label, self.counters)
        if node is not None:
            node.close()
        self._waker.close()

    def _open(self) -> Stream:
        section, lens = self._section, self._spec.lens
        self._waker.open()
        node, identity = self._finder.open()
        self._node = node
        self.agreement = agreement = negotiate(node, identity, self._label, section.format, lens.size_px, section.fps)
        self._locks.switch_off(node, self._label)
        set_controls(node, self._label, section.controls)
        self._locks.hold(node, self._label, section.controls)
        if section.exposure is not None:
            self._exposure = Exposure(node, self._label, section.exposure, max(lens.focal_px))
        self._exposure_s = exposure_time_s(node) or section.exposure_s
        self._stream = stream = Stream(node, self._label, section.format, agreement.given, self.counters)
        self._stall_s = max(section.stall_s, _STALL_PERIODS / agreement.given_fps if agreement.given_fps else 0.0)
        self._due_s = self._clock.now_s() + max(START_S, self._stall_s)
        return stream

    def _next(self, stream: Stream, deadline_s: float) -> Frame | None:
        while True:
            ready = stream.poll(self._waker.fd, max(0.0, min(deadline_s, self._due_s) - self._clock.now_s()))
            if ready.woken:
                self._waker.clear()
                return None
            filled = stream.newest() if ready.frame or ready.fault else None
            if filled is not None and (frame := self._frame(stream, filled)) is not None:
                self._due_s = self._clock.now_s() + self._stall_s
                return frame
            if ready.fault and not ready.frame:
                raise LinkLost(f"{self._label} has stopped streaming; it may have been unplugged")
            now_s = self._clock.now_s()
            if now_s >= self._due_s:
                raise self._stalled()
            if now_s >= deadline_s:
                return None

    def _stalled(self) -> LinkLost:
        return LinkLost(
            f"{self._label} has stalled: it is open and delivers no good picture ({self.counters})", LinkLoss.STALLED
        )

    def _frame(self, stream: Stream, filled: Filled) -> Frame | None:
        stamp = mid_exposure(
            filled.stamp_s,
            filled.flags,
            self._clock.now_s(),
            exposure_s=self._exposure_s,
            readout_s=self._spec.readout_s,
        )
        image = stream.picture(filled)
        if image is None:
            return None
        note = ""
        if self._exposure is not None:
            note = self._exposure.follow(image)
            self._exposure_s = self._exposure.exposure_s
        return Frame(self._spec.id, image, stamp.stamp_s, filled.sequence, stamp.known, note=note)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            path = self._node.path if self._node else self._section.device
            raise explain(self._label, path, error) from error


def make(sections: Mapping[str, tuple[CameraSpec, V4l2Section]]) -> dict[str, Camera]:
    """Build the cameras; opens nothing."""
    clock, port = RealClock(), KernelPort()
    return {camera: V4l2Camera(spec, section, clock, port) for camera, (spec, section) in sections.items()}
