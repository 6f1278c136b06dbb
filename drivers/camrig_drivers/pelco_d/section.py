"""The keys of a ``driver: pelco_d`` head in the YAML."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from camrig.rig import HeadSpec
from camrig_drivers.pelco_d.codec import Echo
from camrig_drivers.pelco_d.commands import SPECIAL_PRESETS, TOP_SPEED, TURBO, Dialect

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_AXES = ("pan", "tilt")

Seconds = Annotated[float, Field(ge=0.0, le=60.0)]
BendDeg = Annotated[float, Field(ge=-5.0, le=5.0)]
SigmaDeg = Annotated[float, Field(ge=0.0, le=10.0)]


class Grade(StrEnum):
    """How a head is pointed."""

    ABSOLUTE = "absolute"
    """It is sent to positions, and tells where it is."""
    VELOCITY = "velocity"
    """It is steered by speed bytes, and tells where it is."""
    OPEN_LOOP = "open_loop"
    """It is steered by speed bytes and time, and tells nothing."""


class AxisSection(BaseModel):
    """How one axis counts: ``deg = sign * (raw * scale) + offset_deg``, raw in degrees, wrapped into -180..180.

    ``camrig calibrate head`` finds all of it.
    """

    model_config = _STRICT

    sign: Literal[-1, 1] = -1
    """-1: raw pan grows clockwise seen from above, raw tilt grows downward, as most heads count."""
    scale: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    sine_deg: BendDeg = 0.0
    cosine_deg: BendDeg = 0.0
    """Added to that: ``sine_deg * sin(deg) + cosine_deg * cos(deg)``, as of a wheel that runs off its centre."""
    resolution_deg: Annotated[float, Field(ge=0.0, le=5.0)] = 0.01
    """Step of what the head reports, where it is coarser than the protocol's hundredth of a degree."""
    arrival_deg: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """A head that stops this close to its target is there; further off it is sent again."""
    backlash_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Full width of the play between the reported and the true axis."""
    approach: Literal["rising", "falling", "any"] = "rising"
    """From which side a target is approached where there is play."""
    drive_sign: Literal[-1, 1] = -1
    """-1: the right (down) bit turns towards falling angles, as on an upright head."""
    speeds: dict[Annotated[int, Field(ge=1, le=TURBO)], Annotated[float, Field(gt=0.0, le=400.0)]] | None = None
    """Measured deg/s of speed bytes 1..63 (pan also 64, turbo), straight in between; bytes beyond are not sent."""
    acceleration_deg_s2: Annotated[float, Field(gt=0.0, le=10_000.0)] = 160.0
    """How the axis takes up a new speed, up or down."""

    @field_validator("speeds")
    @classmethod
    def _grows(cls, speeds: dict[int, float] | None) -> dict[int, float] | None:
        if speeds is not None and not speeds:
            raise ValueError("is empty; give at least one speed byte, as in {63: 40.0}")
        for (low, slow), (high, fast) in pairwise(sorted((speeds or {}).items())):
            if fast <= slow:
                raise ValueError(f"speeds grow with their byte; {slow:g} deg/s at {low} and {fast:g} at {high} do not")
        return speeds


class AxesSection(BaseModel):
    """Both axes."""

    model_config = _STRICT

    pan: AxisSection = AxisSection()
    tilt: AxisSection = AxisSection()


class ZeroSection(BaseModel):
    """How an open-loop head finds out where it is: a preset whose direction is known, end stops, or anchors alone."""

    model_config = _STRICT

    by: Literal["preset", "end_stops", "anchors"]
    preset: Annotated[int, Field(ge=1, le=255)] | None = None
    pan_deg: float | None = None
    """Of the preset, or of the end stop that is driven into."""
    tilt_deg: float | None = None
    sigma_deg: SigmaDeg = 0.5
    travel_s: Annotated[float, Field(gt=0.0, le=300.0)] = 20.0
    """How long the longest way there takes."""

    @model_validator(mode="after")
    def _complete(self) -> ZeroSection:
        if (self.by == "preset") != (self.preset is not None):
            raise ValueError("preset goes with by: preset, and by: preset needs it")
        if any((self.by == "anchors") != (angle is None) for angle in (self.pan_deg, self.tilt_deg)):
            raise ValueError("pan_deg and tilt_deg go with by: preset and by: end_stops, which need both")
        return self


class OpenLoopSection(BaseModel):
    """The time model of a head that tells nothing."""

    model_config = _STRICT

    zero: ZeroSection
    start_s: Seconds = 0.1
    """From the end of a command to motion."""
    start_sigma_s: Seconds = 0.03
    stop_sigma_s: Seconds = 0.01
    speed_sigma: Annotated[float, Field(ge=0.0, le=0.5)] = 0.05
    """One sigma of the speed of a move, relative to the table's."""
    rezero_above_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 3.0
    """When one sigma exceeds it the head zeroes itself before its next move."""


def _unquoted(value: object) -> object:
    """Undo YAML, to which a bare yes or no is true or false."""
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


class CameraSection(BaseModel):
    """What of the head's own camera is set whenever the head is enabled, so that its lens stays the calibrated one."""

    model_config = _STRICT

    auto_focus: bool | None = None
    auto_iris: bool | None = None
    agc: bool | None = None
    blc: bool | None = None
    awb: bool | None = None
    magnification: Annotated[float, Field(ge=0.0, le=655.35)] | None = None


class PelcoDSection(BaseModel):
    """One head on a serial line."""

    model_config = _STRICT

    port: Annotated[str, Field(min_length=1)]
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    address: Annotated[int, Field(ge=1, le=254)] = 1
    grade: Grade = Grade.ABSOLUTE
    axes: AxesSection = AxesSection()
    readback_sigma_deg: SigmaDeg = 0.01
    """One sigma of a reported angle, beyond its last digit."""
    report_age_s: Annotated[float, Field(ge=-2.0, le=2.0)] = 0.0
    """How long before its stamp a reported angle was so, by the stamps of the camera that it carries."""
    start_s: Seconds = 0.05
    """From the end of a command to motion."""
    reply_timeout_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.1
    """The longest that a reply may take to begin; what is waited for adapts to the head below that."""
    gap_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.05
    refresh_s: Annotated[float, Field(gt=0.0, le=14.0)] = 5.0
    """A speed command is said again after so long: heads with a dead-man's time-out end it from 15 s on."""
    echo: Annotated[Echo, BeforeValidator(_unquoted)] = Echo.AUTO
    resync_tail: bool = False
    """Believe replies whose first 1..3 bytes the adapter lost, completed from the question."""
    open_loop: OpenLoopSection | None = None
    special_presets: bool = False
    """Allow ``open_loop.zero.preset`` to be one of 33, 34, 84..105, which many heads take as orders."""
    camera: CameraSection = CameraSection()
    dialect: Dialect = Dialect()
    """Contested command bytes: turbo, and those of ``camera``."""

    @model_validator(mode="after")
    def _complete(self) -> PelcoDSection:
        if self.grade is not Grade.ABSOLUTE:
            for name in _AXES:
                if getattr(self.axes, name).speeds is None:
                    raise ValueError(f"grade {self.grade} needs axes.{name}.speeds, the measured deg/s of speed bytes")
        if (self.grade is Grade.OPEN_LOOP) != (self.open_loop is not None):
            raise ValueError("open_loop goes with grade: open_loop, which needs it")
        if max(self.axes.tilt.speeds or [0]) > TOP_SPEED:
            raise ValueError("axes.tilt.speeds: tilt has no turbo; its bytes are 1..63")
        if max(self.axes.pan.speeds or [0]) > TOP_SPEED and self.dialect.turbo is None:
            raise ValueError("axes.pan.speeds: byte 64 is turbo; give dialect.turbo the byte of the head's manual")
        preset = self.open_loop.zero.preset if self.open_loop else None
        if preset in SPECIAL_PRESETS and not self.special_presets:
            raise ValueError(
                f"open_loop.zero.preset: {preset} is an order to many heads; set special_presets to use it"
            )
        return self


def line_of(port: str) -> str:
    """Return the device behind a port's name, so that two names of one line meet."""
    return os.path.realpath(port)


def check(heads: Mapping[str, tuple[HeadSpec, PelcoDSection]]) -> Sequence[tuple[str, str, str]]:
    """Return the faults that only all heads together show, as (id, key, message)."""
    faults = []
    seen: dict[str, list[str]] = {}
    for name, (spec, section) in heads.items():
        others = seen.setdefault(line_of(section.port), [])
        faults += [(name, key, message) for key, message in _against(section, [(o, heads[o][1]) for o in others])]
        faults += [(name, key, message) for key, message in _ambiguous(spec, section)]
        others.append(name)
    return faults


def _against(section: PelcoDSection, others: Sequence[tuple[str, PelcoDSection]]) -> Sequence[tuple[str, str]]:
    """Compare a head with the heads before it on its line."""
    faults = [
        ("address", f"address {section.address} is taken by head {name} on the same port; give each its own, 1..254")
        for name, other in others
        if other.address == section.address
    ][:1]
    for name, first in others[:1]:
        faults += [
            (key, f"is {getattr(section, key)} here and {getattr(first, key)} for head {name} on the same port")
            for key in ("baud", "echo", "resync_tail")
            if getattr(section, key) != getattr(first, key)
        ]
    return faults


def _ambiguous(spec: HeadSpec, section: PelcoDSection) -> Sequence[tuple[str, str]]:
    """Find limits wider than what a read-back, which wraps every turn, can tell apart."""
    faults = []
    for key, (low_rad, high_rad), axis in (
        ("pan_deg", spec.pan_limits_rad, section.axes.pan),
        ("tilt_deg", spec.tilt_limits_rad, section.axes.tilt),
    ):
        wider = high_rad - low_rad > math.radians(360.0 * axis.scale) + 1e-9
        if wider and section.grade is not Grade.OPEN_LOOP:
            faults.append((key, f"limits span more than the {360.0 * axis.scale:g} deg that read-back tells apart"))
    return faults
