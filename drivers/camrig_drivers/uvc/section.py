"""The keys of a ``driver: uvc`` head in the YAML."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from camrig.rig import HeadSpec

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class UvcAxisSection(BaseModel):
    """How one axis counts: ``deg = sign * value / 3600 + offset_deg``, values being seconds of arc."""

    model_config = _STRICT

    sign: Literal[-1, 1]
    offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    backlash_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Full width of the play between the reported and the true axis; it widens the sigma of a reading."""


class UvcAxesSection(BaseModel):
    """Both axes; the defaults are what the kernel's documentation says: pan grows to the right, tilt upwards."""

    model_config = _STRICT

    pan: UvcAxisSection = UvcAxisSection(sign=-1)
    tilt: UvcAxisSection = UvcAxisSection(sign=1)


class UvcSection(BaseModel):
    """One head; its camera streams from the same device, as ``driver: v4l2``."""

    model_config = _STRICT

    device: Annotated[str, Field(min_length=1)]
    """Best a name of /dev/v4l/by-id or by-path; or ``serial=…`` or ``bus=…``, as a camera's."""
    axes: UvcAxesSection = UvcAxesSection()
    reports: Literal["target", "position"] = "target"
    """What the controls hold while the head moves; with target it is unknown until it must be there."""
    settle_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """Added to the way at the head's speed until it must be there."""
    zoom: Annotated[int, Field(ge=0)] | None = None
    """The zoom at which the lens was calibrated: set with the first move after each enabling."""
    readback_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.05
    """One sigma of a reported angle, beyond its step."""
    poll_s: Annotated[float, Field(ge=0.01, le=1.0)] = 0.05
    """From one reading to the next."""


def check(heads: Mapping[str, tuple[HeadSpec, UvcSection]]) -> Sequence[tuple[str, str, str]]:
    """Return the faults that only all heads together show, as (id, key, message)."""
    faults = []
    first: dict[str, str] = {}
    for name, (_, section) in heads.items():
        earlier = first.setdefault(os.path.realpath(section.device), name)
        if earlier != name:
            faults.append((name, "device", f"{section.device} is already the device of head {earlier}"))
    return faults
