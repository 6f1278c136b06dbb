"""The keys of a ``driver: pelco_d`` head in the YAML."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from camrig.rig import HeadSpec
from camrig_drivers.pelco_d.codec import Echo
from camrig_drivers.pelco_d.commands import Dialect

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class AxisSection(BaseModel):
    """How one axis counts: ``deg = sign * (raw * scale) + offset_deg``, raw in degrees, wrapped into -180..180."""

    model_config = _STRICT

    sign: Literal[-1, 1] = -1
    """-1: raw pan grows clockwise seen from above, raw tilt grows downward, as most heads count."""
    scale: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    backlash_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Full width of the play between the reported and the true axis; it widens the sigma of a reading."""


class AxesSection(BaseModel):
    """Both axes."""

    model_config = _STRICT

    pan: AxisSection = AxisSection()
    tilt: AxisSection = AxisSection()


def _unquoted(value: object) -> object:
    """Undo YAML, to which a bare yes or no is true or false."""
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


class PelcoDSection(BaseModel):
    """One head on a serial line."""

    model_config = _STRICT

    port: Annotated[str, Field(min_length=1)]
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    address: Annotated[int, Field(ge=1, le=254)] = 1
    axes: AxesSection = AxesSection()
    readback_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.01
    """One sigma of a reported angle, beyond its last digit."""
    reply_timeout_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.1
    gap_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.05
    echo: Annotated[Echo, BeforeValidator(_unquoted)] = Echo.AUTO
    resync_tail: bool = False
    """Believe replies whose first 1..3 bytes the adapter lost, completed from the question."""
    dialect: Dialect = Dialect()
    """Contested command bytes, for the commands that have them; absolute pointing has none."""


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
        if high_rad - low_rad > math.radians(360.0 * axis.scale) + 1e-9:
            faults.append((key, f"limits span more than the {360.0 * axis.scale:g} deg that read-back tells apart"))
    return faults
