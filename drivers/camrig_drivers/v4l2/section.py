"""The ``source:`` section of a camera on a V4L2 device."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, model_validator

from camrig.rig import CameraSpec
from camrig_drivers.v4l2.controls import Value
from camrig_drivers.v4l2.grey import PixelFormat
from camrig_drivers.v4l2.locks import Lock

_GOVERNED = {"auto_exposure", "exposure_time_absolute", "gain", "gain_automatic"}


def _control_value(value: object) -> Value:
    """Only the device knows more; a plain validator gives one message where a union gives three."""
    if not isinstance(value, (bool, int, str)):
        raise ValueError("must be true, false, a whole number or the name of a menu's item")  # noqa: TRY004
    return value


class BlurLimit(BaseModel):
    """An exposure ruled by camrig: what crosses the picture at this speed is smeared by no more than this."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    max_blur_px: Annotated[float, Field(gt=0.0, le=100.0)]
    speed_deg_s: Annotated[float, Field(gt=0.0, le=3600.0)]
    """How fast the quickest thing crosses the view, or the head turns while it must still see."""
    brightness: Annotated[float, Field(ge=20.0, le=230.0)] = 150.0
    """The grey that white shall have."""
    max_gain: int | None = None
    """Gain is noise; None allows all that the device has."""

    def longest_s(self, focal_px: float) -> float:
        """Return the longest exposure that keeps to the limit with a lens of this focal length."""
        return self.max_blur_px / (math.radians(self.speed_deg_s) * focal_px)


class V4l2Section(BaseModel):
    """One camera. Pictures are asked for in the size of the camera's lens."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    device: Annotated[str, Field(min_length=1)]
    """Best a name of /dev/v4l/by-id or by-path, ``serial=…`` of the USB device, or ``bus=…`` as ``bus_info`` tells it:
    after a replug /dev/video0 may be another camera.
    """
    format: PixelFormat = "YUYV"
    fps: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    """None leaves the device's own."""
    controls: dict[str, Annotated[Value, PlainValidator(_control_value)]] = {}
    exposure_s: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    """The exposure time of a device that does not tell it; for the stamps only, it sets nothing."""
    lock: tuple[Lock, ...] = ()
    """Automatic modes to switch off; what they governed is held as it is found, over every replug."""
    exposure: BlurLimit | None = None
    """Takes exposure and gain over; None leaves them to ``controls``, or to the device."""
    stall_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    """Without a picture for so long (and for ten of its periods) the device is taken to have stalled."""

    @model_validator(mode="after")
    def _one_master(self) -> Self:
        taken = sorted(_GOVERNED & self.controls.keys()) if self.exposure else []
        if taken:
            raise ValueError(f"`exposure` rules {', '.join(taken)} itself; take that out of `controls`")
        return self


def check(cameras: Mapping[str, tuple[CameraSpec, V4l2Section]]) -> Sequence[tuple[str, str, str]]:
    """Return the faults that only all cameras together show, as (id, key, message)."""
    faults = []
    first: dict[str, str] = {}
    for name, (_, section) in cameras.items():
        earlier = first.setdefault(os.path.realpath(section.device), name)
        if earlier != name:
            faults.append((name, "device", f"{section.device} is already the device of camera {earlier}"))
    return faults
