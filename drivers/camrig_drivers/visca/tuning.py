"""What a head's calibration changes in its section. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from camrig.interfaces import HeadTuning
from camrig.messages import HeadFindings
from camrig_drivers.visca.section import ViscaSection


def plain(section: ViscaSection) -> ViscaSection:
    """Return a section that reports what the motor does, as the file counts."""
    axes = section.axes.model_copy(
        update={name: getattr(section.axes, name).model_copy(update={"backlash_deg": 0.0}) for name in ("pan", "tilt")}
    )
    return section.model_copy(update={"axes": axes})


def changes(section: ViscaSection, found: HeadFindings) -> Mapping[tuple[str, ...], object]:
    """Return the keys to write, rounded to what they are good for."""
    written: dict[tuple[str, ...], object] = {}
    for name, axis, was in (("pan", found.pan, section.axes.pan), ("tilt", found.tilt, section.axes.tilt)):
        signed = was.sign * was.deg_per_count * axis.factor
        written["axes", name, "sign"] = 1 if signed > 0.0 else -1
        written["axes", name, "deg_per_count"] = round(abs(signed), 7)
        written["axes", name, "offset_deg"] = round(axis.factor * was.offset_deg + math.degrees(axis.offset_rad), 4)
        written["axes", name, "backlash_deg"] = round(max(0.0, math.degrees(axis.play_rad)), 4)
    return written


tuning = HeadTuning(plain=plain, changes=changes)
