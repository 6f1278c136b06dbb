"""The ``source:`` section of a camera on a V4L2 device."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, PlainValidator

from camrig.rig import CameraSpec
from camrig_drivers.v4l2.controls import Value
from camrig_drivers.v4l2.grey import PixelFormat


def _control_value(value: object) -> Value:
    """Only the device knows more; a plain validator gives one message where a union gives three."""
    if not isinstance(value, (bool, int, str)):
        raise ValueError("must be true, false, a whole number or the name of a menu's item")  # noqa: TRY004
    return value


class V4l2Section(BaseModel):
    """One camera. Pictures are asked for in the size of the camera's lens."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    device: Annotated[str, Field(min_length=1)]
    """Best a name of /dev/v4l/by-id or by-path: after a replug /dev/video0 may be another camera."""
    format: PixelFormat = "YUYV"
    fps: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    """None leaves the device's own."""
    controls: dict[str, Annotated[Value, PlainValidator(_control_value)]] = {}
    exposure_s: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    """The exposure time of a device that does not tell it; for the stamps only, it sets nothing."""


def check(cameras: Mapping[str, tuple[CameraSpec, V4l2Section]]) -> Sequence[tuple[str, str, str]]:
    """Return the faults that only all cameras together show, as (id, key, message)."""
    faults = []
    first: dict[str, str] = {}
    for name, (_, section) in cameras.items():
        earlier = first.setdefault(os.path.realpath(section.device), name)
        if earlier != name:
            faults.append((name, "device", f"{section.device} is already the device of camera {earlier}"))
    return faults
