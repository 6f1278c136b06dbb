"""What a camera's worker does. Images never cross threads: detections do."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from camrig.clock import Clock
from camrig.detect import blindness, detect_tags
from camrig.errors import InputError
from camrig.geometry.lens import Lens
from camrig.interfaces import Camera, TagDetector
from camrig.messages import Event, Expected, Frame, Level, TagDetections, Window
from camrig.rig import TagKey
from camrig.runtime.complaints import Complaints
from camrig.runtime.link_counts import counted
from camrig.runtime.mailbox import Mailbox

CAMERA_TIMEOUT_S = 0.5
WHOLE_EVERY_S = 0.5
LEAST_BETWEEN = 9
"""The whole picture is searched so often even when every target is where it is expected, but of ten pictures at most
one: where that takes half a second, each would be due.
"""

FAULTS = ("unusable_frames", "blind_frames", "odd_sized_frames", "repeated_tags")
"""What is counted: pictures that no detector takes, black or over-exposed ones, ones of another size than the lens is
for; and tags whose number another one in the same picture has too.
"""


@dataclass
class CameraJob:
    """Dequeues frames and detects the tags in each: where they are expected, and now and then in the whole picture.

    As soon as a tag is missing that the picture before showed, the whole of that same picture is searched.
    """

    name: str
    camera: Camera
    make_detector: Callable[[], TagDetector]
    clock: Clock
    lens: Lens
    refine: bool = True
    """Whether corners are refined through the lens; else they stay as the detector finds them."""
    detections: Mailbox[TagDetections] = field(default_factory=lambda: Mailbox(4))
    expected: Mailbox[Expected] = field(default_factory=lambda: Mailbox(1))
    told: Callable[[TagDetections], None] | None = None
    """Gets what was found at once, in this thread: who navigates by it cannot wait for the pipeline."""
    news: threading.Event = field(default_factory=threading.Event)
    """Set once there are new detections: the control thread need not wait for its next tick."""
    notes: Mailbox[Event] = field(default_factory=lambda: Mailbox(4))
    frames: int = 0
    whole_frames: int = 0
    detect_s: float = 0.0
    _detector: TagDetector | None = None
    _whole_s: float = float("-inf")
    _since_whole: int = LEAST_BETWEEN
    _present: frozenset[TagKey] = frozenset()
    _note: str = ""
    _complaints: Complaints = field(init=False)
    _faults: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))

    def __post_init__(self) -> None:
        self._complaints = Complaints(self.name, self.notes.put)

    def open(self) -> None:
        if self._detector is None:  # one detector per thread, kept for the life of the process
            self._detector = self.make_detector()
        self.camera.open()

    def turn(self) -> None:
        frame = self.camera.read(CAMERA_TIMEOUT_S)
        if frame is None or self._detector is None:
            return
        self._tell(frame)
        self.frames += 1
        faults, found = self._searched(frame, self._detector)
        self._complaints.take(frame.stamp_s, faults)
        if found is None:
            return
        self.whole_frames += found.whole
        self.detect_s += found.detect_s
        if self.told is not None:
            self.told(found)
        self.detections.put(found)
        self.news.set()

    def _searched(self, frame: Frame, detector: TagDetector) -> tuple[dict[str, str], TagDetections | None]:
        """Return what is wrong with a frame, by kind, and what was found in it; None where it cannot be searched."""
        windows = self._windows(frame)
        wanted = self._present.intersection(window.key for window in windows or () if window.key is not None)
        try:
            found = detect_tags(frame, detector, self.clock.now_s, windows, self.lens if self.refine else None, wanted)
        except InputError as error:
            self._faults["unusable_frames"] += 1
            return {"unusable": f"pictures cannot be searched: {error}"}, None
        if found.whole:
            self._whole_s, self._since_whole = found.stamp_s, 0
        self._since_whole += not found.whole
        self._present = frozenset(tag.key for tag in found.tags)
        self._faults["repeated_tags"] += len(found.tags) - len(self._present)
        self._faults["odd_sized_frames"] += found.size_px != self.lens.size_px
        blind = "" if found.tags else blindness(frame.image)
        self._faults["blind_frames"] += bool(blind)
        return ({"blind": blind} if blind else {}), found

    def _windows(self, frame: Frame) -> tuple[Window, ...] | None:
        """Return where to search a frame; None: everywhere, also where it is not of the size that was reckoned with."""
        expected = self.expected.newest()
        due = frame.stamp_s >= self._whole_s + WHOLE_EVERY_S and self._since_whole >= LEAST_BETWEEN
        if due or expected is None or not expected.holds_at(frame.stamp_s):
            return None
        return expected.windows_at(frame.stamp_s) if frame.image.shape[::-1] == self.lens.size_px else None

    def _tell(self, frame: Frame) -> None:
        if frame.note != self._note:
            level = Level.WARNING if frame.note else Level.INFO
            self.notes.put(Event(frame.stamp_s, level, self.name, frame.note or "no longer so: " + self._note))
            self._note = frame.note

    def close(self) -> None:
        self.camera.close()

    def wake(self) -> None:
        self.camera.wake()

    def statistics(self) -> Mapping[str, float]:
        """Return what was counted of its pictures and of its link; any thread."""
        pictures = {"frames": self.frames, "whole_frames": self.whole_frames, "detect_s": self.detect_s}
        return {**pictures, **self._faults, **counted(self.camera)}
