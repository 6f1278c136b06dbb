"""A camera on a V4L2 device."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from camrig.clock import Clock, RealClock
from camrig.errors import LinkLost
from camrig.interfaces import Camera
from camrig.messages import Frame
from camrig.rig import CameraSpec
from camrig_drivers.v4l2.controls import exposure_time_s, set_controls
from camrig_drivers.v4l2.negotiation import negotiate
from camrig_drivers.v4l2.node import Filled, Node
from camrig_drivers.v4l2.port import IoctlPort, KernelPort
from camrig_drivers.v4l2.section import V4l2Section
from camrig_drivers.v4l2.stamps import mid_exposure
from camrig_drivers.v4l2.stream import Counters, Stream
from camrig_drivers.v4l2.trouble import explain
from camrig_drivers.v4l2.waker import Waker

_log = logging.getLogger(__name__)


class V4l2Camera:
    """A ``Camera``; ``wake`` may be called from any thread, all else from one.

    Every ``open`` sets and reads back the format, the rate and all controls: a camera that was unplugged has
    forgotten them. ``counters`` tells what became of the frames.
    """

    def __init__(self, spec: CameraSpec, section: V4l2Section, clock: Clock, port: IoctlPort) -> None:
        self.counters = Counters()
        self._spec = spec
        self._section = section
        self._clock = clock
        self._port = port
        self._label = f"camera {spec.id}: {section.device}"
        self._waker = Waker()
        self._node: Node | None = None
        self._stream: Stream | None = None
        self._exposure_s: float | None = None

    def open(self) -> None:
        """Set everything and start streaming; see ``camrig.interfaces.Camera``.

        HardwareError: no camera, another format or size than asked, a control unknown, out of range or refused.
        LinkLost: all that may pass (absent, in use, no permission, trouble on the bus).
        """
        self.close()
        self.counters = Counters()
        try:
            with self._explained():
                self._open()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> Frame | None:
        """Return the newest frame; see ``camrig.interfaces.Camera``. Damaged frames are dropped and counted."""
        deadline_s = self._clock.now_s() + timeout_s
        while True:
            with self._explained():
                node, stream = self._open_parts()
                ready = node.poll(self._waker.fd, max(0.0, deadline_s - self._clock.now_s()))
                if ready.woken:
                    self._waker.clear()
                    return None
                filled = stream.newest() if ready.frame or ready.fault else None
                if filled is not None and (frame := self._frame(stream, filled)) is not None:
                    return frame
            if ready.fault and not ready.frame:
                raise LinkLost(f"{self._label} has stopped streaming; it may have been unplugged")
            if self._clock.now_s() >= deadline_s:
                return None

    def wake(self) -> None:
        """Make ``read``, now or the next, return None."""
        self._waker.wake()

    def close(self) -> None:
        """Stop streaming and let go of the device; twice is allowed."""
        stream, node = self._stream, self._node
        self._stream = self._node = None
        if stream is not None:
            stream.close()
            _log.info("%s closed: %s", self._label, self.counters)
        if node is not None:
            node.close()
        self._waker.close()

    def _open(self) -> None:
        section = self._section
        self._waker.open()
        self._node = node = Node(self._port, section.device)
        given = negotiate(node, self._label, section.format, self._spec.lens.size_px, section.fps)
        set_controls(node, self._label, section.controls)
        self._exposure_s = exposure_time_s(node) or section.exposure_s
        self._stream = Stream(node, self._label, section.format, given, self.counters)

    def _open_parts(self) -> tuple[Node, Stream]:
        if self._node is None or self._stream is None:
            raise LinkLost(f"{self._label} is not open")
        return self._node, self._stream

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
        return Frame(self._spec.id, image, stamp.stamp_s, filled.sequence, stamp.known)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise explain(self._label, self._section.device, error) from error


def make(sections: Mapping[str, tuple[CameraSpec, V4l2Section]]) -> dict[str, Camera]:
    """Build the cameras; opens nothing."""
    clock, port = RealClock(), KernelPort()
    return {camera: V4l2Camera(spec, section, clock, port) for camera, (spec, section) in sections.items()}
