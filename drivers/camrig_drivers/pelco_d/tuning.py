"""What a head's calibration changes in its section. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from camrig.interfaces import HeadTuning
from camrig.messages import AxisFindings, HeadFindings
from camrig_drivers.pelco_d.section import AxisSection, Grade, PelcoDSection

_GRADES = {"absolute": Grade.ABSOLUTE, "servo": Grade.VELOCITY, "open loop": Grade.OPEN_LOOP}


def plain(section: PelcoDSection) -> PelcoDSection:
    """Return a section that reports what the motor does, as the file counts."""
    nothing = {"backlash_deg": 0.0, "sine_deg": 0.0, "cosine_deg": 0.0}
    axes = section.axes.model_copy(
        update={name: getattr(section.axes, name).model_copy(update=nothing) for name in ("pan", "tilt")}
    )
    return section.model_copy(update={"axes": axes, "report_age_s": 0.0})


def changes(section: PelcoDSection, found: HeadFindings) -> Mapping[tuple[str, ...], object]:
    """Return the keys to write, rounded to what they are good for."""
    written: dict[tuple[str, ...], object] = {}
    reads_back = tells_its_angles(section)
    for name, axis, was in (("pan", found.pan, section.axes.pan), ("tilt", found.tilt, section.axes.tilt)):
        counting = _counting(axis, was) if reads_back else {}
        written |= {("axes", name, key): value for key, value in {**counting, **_speeds(axis, was)}.items()}
    if found.report_age_s is not None and reads_back:
        written["report_age_s",] = round(found.report_age_s, 4)
    if found.start_s is not None:
        where = ("start_s",) if reads_back else ("open_loop", "start_s")
        written[where] = round(max(0.0, found.start_s), 3)
    if found.speed_sigma is not None and not reads_back:
        written["open_loop", "speed_sigma"] = round(min(0.5, max(0.002, found.speed_sigma)), 4)
    grade = _GRADES[found.grade]
    if grade is not section.grade and grade is Grade.VELOCITY and found.pan.speeds_rad_s and found.tilt.speeds_rad_s:
        written["grade",] = grade.value
    return written


def tells_its_angles(section: PelcoDSection) -> bool:
    """Tell whether a head with this section is asked for its angles."""
    return section.grade is not Grade.OPEN_LOOP


def _counting(axis: AxisFindings, was: AxisSection) -> dict[str, object]:
    signed = was.sign * was.scale * axis.factor
    offset_deg = axis.factor * was.offset_deg + math.degrees(axis.offset_rad)
    counting: dict[str, object] = {
        "sign": 1 if signed > 0.0 else -1,
        "scale": round(abs(signed), 6),
        "offset_deg": round(math.remainder(offset_deg, 360.0 * abs(signed)), 4),
        "backlash_deg": round(max(0.0, math.degrees(axis.play_rad)), 4),
    }
    for key, bend_rad in (("sine_deg", axis.sine_rad), ("cosine_deg", axis.cosine_rad)):
        if bend_rad or getattr(was, key):
            counting[key] = round(math.degrees(bend_rad), 4)
    return counting


def _speeds(axis: AxisFindings, was: AxisSection) -> dict[str, object]:
    if not axis.speeds_rad_s:
        return {}
    speeds = {step: round(math.degrees(speed), 4) for step, speed in sorted(axis.speeds_rad_s.items())}
    growing = {str(step): speed for step, speed in speeds.items() if speed > max([0.0, *_below(speeds, step)])}
    found: dict[str, object] = {"drive_sign": was.drive_sign * axis.drive, "speeds": growing}
    if axis.acceleration_rad_s2 is not None:
        found["acceleration_deg_s2"] = round(math.degrees(axis.acceleration_rad_s2), 1)
    return found


def _below(speeds: Mapping[int, float], step: int) -> list[float]:
    return [speed for other, speed in speeds.items() if other < step]


tuning = HeadTuning(plain=plain, changes=changes, reads_back=tells_its_angles)
