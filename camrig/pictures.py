"""Pictures and videos from disk as grey arrays: what the ``images`` camera and the command line read.

A picture is decoded as it is stored: a JPEG straight to its brightness, its EXIF orientation ignored, so that pixels
are those of the sensor and a lens calibration fits. A file that ends early is no picture: OpenCV's decoders of data
in memory refuse it, where those of files would fill the rest with grey. Damage that still decodes is not noticed.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage

PICTURE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
"""What of a folder is read; a file that is named itself may be called anything."""
VIDEO_SUFFIXES = frozenset({".avi", ".m4v", ".mjpeg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm"})

_COMPLETE = 0.9
"""A video with fewer of the frames that it announces ends early; the announcement may itself be an estimate."""

# Whoever asks for a picture that cannot be read gets a sentence; the decoders' own lines on stderr would repeat it.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture of a file (``frame`` counts those of a video), or ``fault``: a sentence why there is none."""

    path: Path
    frame: int
    image: GreyImage | None
    fault: str = ""


def find(place: str) -> tuple[Path, ...]:
    """Return the files of a place, in the order of the numbers in their names: a file, the pictures of a folder
    (not of those inside it), or what a glob matches.

    Raises InputError where there is nothing to read.
    """
    path = Path(place).expanduser()
    try:
        if path.is_dir():
            found = [file for file in path.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES and file.is_file()]
        elif path.exists():
            return (path,)
        else:
            found = [Path(match) for match in glob.glob(str(path)) if Path(match).is_file()]
    except OSError as error:
        raise InputError(f"{place} cannot be read: {error.strerror}") from error
    if path.is_dir() and not found:
        raise InputError(f"{place} holds no picture ({', '.join(sorted(PICTURE_SUFFIXES))})")
    if not found:
        raise InputError(f"{place}: no such file or folder")
    return tuple(sorted(found, key=_natural))


def read(paths: Sequence[Path]) -> Iterator[Picture]:
    """Read pictures and videos one by one; what cannot be read comes as a fault and does not end the rest."""
    for path in paths:
        if is_video(path):
            yield from _read_video(path)
        else:
            yield _read_picture(path)


def count(paths: Sequence[Path]) -> int:
    """Return how many pictures ``read`` will give; a video's own word counts, which may be an estimate."""
    return sum(_announced(path) if is_video(path) else 1 for path in paths)


def is_video(path: Path) -> bool:
    """Tell by its name whether a file is read as a video."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def _natural(path: Path) -> tuple[str, list[tuple[int, str]]]:
    parts = re.split(r"(\d+)", path.name)
    return str(path.parent), [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_picture(path: Path) -> Picture:
    try:
        if not path.is_file():
            return Picture(path, 0, None, "no such file" if not path.exists() else "is no file")
        if not cv2.haveImageReader(str(path)):
            return Picture(path, 0, None, _without_reader(path))
        data = np.fromfile(path, dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except OSError as error:
        return Picture(path, 0, None, f"cannot be read: {error.strerror}")
    except cv2.error as error:
        return Picture(path, 0, None, f"is no picture that can be decoded: {error.err}")
    if image is None:
        return Picture(path, 0, None, "is damaged or ends early")
    return Picture(path, 0, np.ascontiguousarray(image, dtype=np.uint8))


def _without_reader(path: Path) -> str:
    """Say why OpenCV knows no reader for a file; raises OSError where it may not be opened at all."""
    with path.open("rb") as file:
        return "is no picture" if file.read(1) else "is empty"


def _read_video(path: Path) -> Iterator[Picture]:
    capture = _open_video(path)
    try:
        frame = 0
        while (image := _next_frame(capture)) is not None:
            yield Picture(path, frame, image)
            frame += 1
        announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if frame == 0:
            yield Picture(path, 0, None, "is no video that can be decoded" if path.is_file() else "no such file")
        elif frame < _COMPLETE * announced:
            yield Picture(path, frame, None, f"ends early: {frame} of {announced} frames could be read")
    finally:
        capture.release()


def _next_frame(capture: cv2.VideoCapture) -> GreyImage | None:
    try:
        taken, image = capture.read()
    except cv2.error:
        return None
    if not taken:
        return None
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _open_video(path: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture()
    if path.is_file():  # a pipe would block
        capture.open(str(path), cv2.CAP_FFMPEG)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0.0)
    return capture


def _announced(path: Path) -> int:
    capture = _open_video(path)
    try:
        return max(1, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
    finally:
        capture.release()
