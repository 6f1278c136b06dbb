"""What a camera's worker does. Images never cross threads: detections do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.clock import Clock
from camrig.detect import detect_tags
from camrig.geometry.lens import Lens
from camrig.interfaces import Camera, TagDetector
from camrig.messages import Event, Expected, Frame, Level, Region, TagDetections
from camrig.runtime.link_counts import counted
from camrig.runtime.mailbox import Mailbox

CAMERA_TIMEOUT_S = 0.5
WHOLE_EVERY_S = 0.5
"""How often the whole picture is searched even when every target is where it is expected."""


@dataclass
class CameraJob:
    """Dequeues frames and detects the tags in each: where they are expected, and now and then in the whole picture."""

    name: str
    camera: Camera
    make_detector: Callable[[], TagDetector]
    clock: Clock
    lens: Lens | None = None
    """Through which corners are refined; None: they stay as the detector finds them."""
    detections: Mailbox[TagDetections] = field(default_factory=lambda: Mailbox(4))
    expected: Mailbox[Expected] = field(default_factory=lambda: Mailbox(1))
    told: Callable[[TagDetections], None] | None = None
    """Gets what was found at once, in this thread: who navigates by it cannot wait for the pipeline."""
    notes: Mailbox[Event] = field(default_factory=lambda: Mailbox(4))
    frames: int = 0
    whole_frames: int = 0
    detect_s: float = 0.0
    _detector: TagDetector | None = None
    _whole_s: float = float("-inf")
    _note: str = ""

    def open(self) -> None:
        if self._detector is None:  # one detector per thread, kept for the life of the process
            self._detector = self.make_detector()
        self.camera.open()

    def turn(self) -> None:
        frame = self.camera.read(CAMERA_TIMEOUT_S)
        if frame is None or self._detector is None:
            return
        self._tell(frame)
        found = detect_tags(frame, self._detector, self.clock.now_s, self._regions(frame.stamp_s), self.lens)
        self._whole_s = found.stamp_s if found.whole else self._whole_s
        self.frames += 1
        self.whole_frames += found.whole
        self.detect_s += found.detect_s
        if self.told is not None:
            self.told(found)
        self.detections.put(found)

    def _tell(self, frame: Frame) -> None:
        if frame.note != self._note:
            level = Level.WARNING if frame.note else Level.INFO
            self.notes.put(Event(frame.stamp_s, level, self.name, frame.note or "no longer so: " + self._note))
            self._note = frame.note

    def _regions(self, stamp_s: float) -> tuple[Region, ...] | None:
        expected = self.expected.newest()
        due = stamp_s >= self._whole_s + WHOLE_EVERY_S
        return None if due or expected is None or not expected.holds_at(stamp_s) else expected.regions

    def close(self) -> None:
        self.camera.close()

    def wake(self) -> None:
        self.camera.wake()

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its link; any thread."""
        return {"frames": self.frames, **counted(self.camera)}
