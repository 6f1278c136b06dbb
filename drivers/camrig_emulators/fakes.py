"""Cameras, heads and drones in memory, for unit tests and for trying a configuration without hardware.

A fake obeys the rules of camrig.interfaces and the clock it is given, and has no wire: for timing, protocol and
trouble on the line there are the emulators. Each has ``faults``: ``unplug`` raises LinkLost until ``replug``,
``silent`` gives nothing, ``freeze`` the last again, ``drop_next`` loses commands (a camera: frames).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from camrig.interfaces import Driver
from camrig.rig import CameraSpec, DroneSpec, HeadSpec
from camrig_emulators.fake_camera import FakeCamera
from camrig_emulators.fake_drone import FakeDrone
from camrig_emulators.fake_head import FakeHead

__all__ = ["FakeCamera", "FakeDrone", "FakeHead", "camera_driver", "drone_driver", "head_driver"]

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FakeCameraSection(BaseModel):
    """The keys of ``driver: fake`` in a camera's source: an even grey picture of the lens's size."""

    model_config = _STRICT

    fps: float = Field(default=10.0, gt=0.0, le=1000.0)
    grey: int = Field(default=128, ge=0, le=255)


class FakeHeadSection(BaseModel):
    """The keys of a head with ``driver: fake``."""

    model_config = _STRICT

    exchange_s: float = Field(default=0.03, gt=0.0, le=1.0)
    """How long one reading takes."""


class FakeDroneSection(BaseModel):
    """The keys of a drone with ``driver: fake``."""

    model_config = _STRICT

    period_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Between two readings."""


def _cameras(sections: Mapping[str, tuple[CameraSpec, FakeCameraSection]]) -> dict[str, FakeCamera]:
    return {name: _camera(spec, section) for name, (spec, section) in sections.items()}


def _camera(spec: CameraSpec, section: FakeCameraSection) -> FakeCamera:
    width, height = spec.lens.size_px
    image = np.full((height, width), section.grey, np.uint8)
    return FakeCamera(spec.id, lambda _stamp_s: image, fps=section.fps)


def _heads(sections: Mapping[str, tuple[HeadSpec, FakeHeadSection]]) -> dict[str, FakeHead]:
    return {name: FakeHead(spec, exchange_s=section.exchange_s) for name, (spec, section) in sections.items()}


def _drones(sections: Mapping[str, tuple[DroneSpec, FakeDroneSection]]) -> dict[str, FakeDrone]:
    return {name: FakeDrone(spec, period_s=section.period_s) for name, (spec, section) in sections.items()}


camera_driver: Driver[CameraSpec, FakeCamera] = Driver(section=FakeCameraSection, make=_cameras)
head_driver: Driver[HeadSpec, FakeHead] = Driver(section=FakeHeadSection, make=_heads)
drone_driver: Driver[DroneSpec, FakeDrone] = Driver(section=FakeDroneSection, make=_drones)
