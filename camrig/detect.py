"""A frame becomes the tags in it."""

from __future__ import annotations

from collections.abc import Callable

from camrig.interfaces import TagDetector
from camrig.messages import Frame, TagDetections


def detect_tags(frame: Frame, detector: TagDetector, now_s: Callable[[], float]) -> TagDetections:
    """Find the tags of a frame; ``now_s`` is the clock that tells how long it took.

    Raises InputError for a picture that no detector takes (a side under 16 px).
    """
    begun_s = now_s()
    tags = detector.detect(frame.image)
    height, width = frame.image.shape
    return TagDetections(
        frame.camera_id, frame.stamp_s, frame.sequence, (width, height), tags, now_s() - begun_s, frame.source
    )
