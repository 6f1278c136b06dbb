"""The ``world:`` section of a rig's YAML, for ``driver: emulated``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from camrig.geometry.arrays import Transform
from camrig_emulators.mavlink.settings import Point
from camrig_emulators.pelco_d_settings import AxisMaps, Limits

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]


class TruePose(BaseModel):
    """A pose as a rig's file has it."""

    model_config = _STRICT

    position_m: Point = (0.0, 0.0, 0.0)
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def matrix(self) -> Transform:
        """Return it (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix()
        T[:3, 3] = self.position_m
        return T


class WorldHeadSection(BaseModel):
    """What an emulated head is like where it shall not be as usual; the keys are those of PelcoDHeadSettings,
    and two poses that a file may have wrong.

    What is not given: it looks at the middle of the floor with tilt -45 deg, has the play and, drawn from the seed,
    the zero error of a good head, and is as fast as the rig says.
    """

    model_config = _STRICT

    start_pan_deg: float | None = None
    start_tilt_deg: float | None = None
    backlash_deg: NotNegative | None = None
    zero_error_deg: tuple[float, float] | None = None
    readback_step_deg: Positive | None = None
    max_speed_deg_s: Positive | None = None
    acceleration_deg_s2: Positive | None = None
    start_latency_s: NotNegative | None = None
    reply_latency_s: NotNegative | None = None
    answers: Literal["none", "general", "queries", "full"] | None = None
    dead_man_s: Positive | None = None
    axes: AxisMaps | None = None
    pan_limits_deg: Limits | None = None
    tilt_limits_deg: Limits | None = None
    absolute: Literal["both", "pan", "tilt", "ignored", "race"] | None = None
    stop_error_deg: NotNegative | None = None
    speed_drift: NotNegative | None = None
    worm_error_deg: NotNegative | None = None
    worm_period_deg: Positive | None = None
    T_arm_tilt: TruePose | None = None
    """Where the tilt axis truly is, where the file does not know it yet."""
    T_mount_camera: TruePose | None = None
    """Likewise its camera."""


class WorldDroneSection(BaseModel):
    """What an emulated drone is like where it shall not be as usual; the keys are those of MavlinkDroneSettings.

    What is not given: it stands on the floor, near its middle, its nose along world x.
    """

    model_config = _STRICT

    start_position_m: Point | None = None
    start_yaw_deg: float | None = None
    flavour: Literal["ardupilot", "px4"] | None = None
    max_speed_m_s: Positive | None = None
    acceleration_m_s2: Positive | None = None
    hover_noise_m: NotNegative | None = None
    estimate_noise_m: NotNegative | None = None
    estimate_noise_deg: NotNegative | None = None
    telemetry_latency_s: NotNegative | None = None
    ready_after_s: NotNegative | None = None
    vision_converges_s: NotNegative | None = None
    figures: Literal["brisk", "measured"] | None = None
    params: dict[str, float] | None = None
    script: str | None = None


class WorldSection(BaseModel):
    """The emulated room; every default makes a plausible one."""

    model_config = _STRICT

    seed: Annotated[int, Field(ge=0)] = 1
    """Of the robots' routes, the devices' imperfections and the noise."""
    start_s: NotNegative = 0.0
    """The world's own time at its start: a second world of one seed goes on where the first was at that time."""
    exposure_s: Annotated[float, Field(gt=0.0, le=0.1)] = 0.004
    noise_grey: Annotated[float, Field(ge=0.0, le=50.0)] = 3.5
    """One sigma of the sensor's noise in grey levels of 255."""
    psf_px: Annotated[float, Field(ge=0.0, le=5.0)] = 0.7
    """One sigma of the optics' point spread."""
    robot_speed_m_s: tuple[Positive, Positive] = (0.1, 0.4)
    """The slowest and the fastest that robots drive."""
    robot_margin_m: NotNegative = 0.35
    """How far the middles of robots keep from the edge of the floor and from boxes."""
    heads: Mapping[str, WorldHeadSection] = {}
    drones: Mapping[str, WorldDroneSection] = {}

    @model_validator(mode="after")
    def _speeds_ascend(self) -> WorldSection:
        slow, fast = self.robot_speed_m_s
        if slow > fast:
            raise ValueError(f"robot_speed_m_s: the slowest ({slow:g}) comes first, then the fastest ({fast:g})")
        return self
