"""When each picture of a sequence is due, in seconds after the first."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from camrig.errors import InputError

DEFAULT_FPS = 10.0


@dataclass(frozen=True, slots=True)
class Timeline:
    """Offsets of the first pictures and the step after them: a declared rate is no offsets and a step."""

    step_s: float
    offsets_s: tuple[float, ...] = ()

    def offset_s(self, index: int) -> float | None:
        """Return when picture ``index`` is due; None past the end of the stamps."""
        if not self.offsets_s:
            return index * self.step_s
        return self.offsets_s[index] if index < len(self.offsets_s) else None


def at_rate(fps: float) -> Timeline:
    """Return the timeline of a declared rate."""
    return Timeline(1.0 / fps)


def from_file(path: Path, names: Sequence[str] | None) -> Timeline:
    """Read a file of stamps: a line per picture with its seconds, or a CSV of file name and seconds.

    ``names`` are the pictures' in their order; None for a video, whose length nobody knows before its end. Raises
    InputError unless every picture has a stamp and stamps ascend.
    """
    rows = _rows(path)
    if all(len(row) == 1 for _, row in rows):
        stamps = [_seconds(path, line, row[0]) for line, row in rows]
        if names is not None and len(stamps) != len(names):
            raise InputError(f"{path} holds {len(stamps)} stamps for {len(names)} pictures; it needs one for each")
    elif names is None:
        raise InputError(f"{path}: a video's stamps are lines of seconds alone, without names")
    else:
        stamps = _by_name(path, rows, names)
    return _timeline(path, stamps)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines that hold something, by number, without a header."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [(number, [cell.strip() for cell in row]) for number, row in enumerate(csv.reader(file), 1)]
    except OSError as error:
        raise InputError(f"stamps {path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"stamps {path} is no text of lines or CSV") from error
    rows = [(number, row) for number, row in rows if any(row) and not row[0].startswith("#")]
    if rows and not _is_number(rows[0][1][-1]):
        rows = rows[1:]
    if not rows:
        raise InputError(f"stamps {path} holds no stamp")
    return rows


def _by_name(path: Path, rows: list[tuple[int, list[str]]], names: Sequence[str]) -> list[float]:
    stamps: dict[str, float] = {}
    for line, row in rows:
        if len(row) != 2:
            raise InputError(f"{path}:{line}: a line is 'filename,seconds', got {','.join(row)!r}")
        if row[0] in stamps:
            raise InputError(f"{path}:{line}: {row[0]} stands twice")
        stamps[row[0]] = _seconds(path, line, row[1])
    missing = [name for name in names if name not in stamps]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(f"{path} has no stamp for {missing[0]}{more}")
    return [stamps[name] for name in names]


def _timeline(path: Path, stamps: list[float]) -> Timeline:
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    for place, step in enumerate(steps):
        if step <= 0.0:
            raise InputError(f"{path}: stamps must ascend; picture {place + 2} is {-step:g} s before the one before it")
    typical = sorted(steps)[len(steps) // 2] if steps else 1.0 / DEFAULT_FPS
    return Timeline(typical, tuple(stamp - stamps[0] for stamp in stamps))


def _seconds(path: Path, line: int, text: str) -> float:
    if not _is_number(text):
        raise InputError(f"{path}:{line}: '{text}' is no number of seconds")
    return float(text)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
