"""Targets as JSON lines, to a file or to standard output (path "-")."""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, TextIO

from pydantic import BaseModel, ConfigDict, Field

from camrig.errors import HardwareError, InputError
from camrig.geometry.rotation import yaw_of
from camrig.interfaces import Plugin, Published, Sink
from camrig.messages import Target, TargetStatus
from camrig.rig import Rig


class JsonlSection(BaseModel):
    """Keys of a ``driver: jsonl`` output."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str = "-"
    rate_hz: Annotated[float, Field(gt=0.0, le=100.0)] = 10.0


@dataclass
class JsonlSink:
    """Writes a line per target at most ``rate_hz`` times a second, and every event at once."""

    section: JsonlSection
    _stream: TextIO | None = None
    _rig_name: str = ""
    _next_s: float = field(default=float("-inf"))

    def open(self, rig: Rig) -> None:
        self._rig_name = rig.name
        if self.section.path == "-":
            self._stream = sys.stdout
            return
        try:
            self._stream = Path(self.section.path).open("a", encoding="utf-8")  # noqa: SIM115 - closed by close()
        except OSError as error:
            raise InputError(f"output '{self.section.path}' cannot be written: {error.strerror}") from error

    def write(self, published: Published) -> None:
        # The wall clock is read here, at the edge: nothing inside camrig knows it.
        utc_offset_s = time.time() - time.monotonic()
        for event in published.events:
            line = {"event": event.text, "about": event.about, "level": event.level.value}
            self._line({**line, "stamp_s": event.stamp_s, "utc": _utc(event.stamp_s + utc_offset_s)})
        if published.stamp_s < self._next_s:
            return
        self._next_s = published.stamp_s + 1.0 / self.section.rate_hz
        for target in published.targets:
            if target.status is not TargetStatus.UNSEEN:
                self._line({**target_line(target), "utc": _utc(target.stamp_s + utc_offset_s)})

    def close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None and stream is not sys.stdout:
            with suppress(OSError):  # every line was flushed: what is left could not be written before either
                stream.close()

    def _line(self, answer: dict[str, object]) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(json.dumps({"rig": self._rig_name, **answer}) + "\n")
            self._stream.flush()
        except OSError as error:
            raise HardwareError(f"output '{self.section.path}' cannot be written any more: {error.strerror}") from error


def target_line(target: Target) -> dict[str, object]:
    """Return a target as it is written: metres and seconds, world frame, covariance (3, 3) row by row."""
    return {
        "target": target.id,
        "status": target.status.value,
        "stamp_s": round(target.stamp_s, 6),
        "clock": "monotonic",
        "frame": "world",
        "position_m": [round(float(value), 5) for value in target.position_m],
        "velocity_m_s": [round(float(value), 5) for value in target.velocity_m_s],
        "covariance_m2": [[float(value) for value in row] for row in target.covariance_m2],
        "yaw_rad": round(yaw_of(target.R_world_body), 5),
        "seen_by": list(target.seen_by),
        "age_s": round(target.stamp_s - target.last_seen_s, 4),
        "quality_m": target.quality_m,
        "planned_sigma_m": target.planned_sigma_m,
        "innovation": None if target.innovation is None else round(target.innovation, 3),
    }


def _utc(wall_s: float) -> str:
    return datetime.fromtimestamp(wall_s, UTC).isoformat(timespec="milliseconds")


def _make(section: JsonlSection) -> Sink:
    return JsonlSink(section)


driver = Plugin(section=JsonlSection, make=_make)
