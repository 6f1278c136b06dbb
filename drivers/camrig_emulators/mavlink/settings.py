"""The section of an emulated MAVLink drone."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Point = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class MavlinkDroneSettings(BaseModel):
    """One emulated drone. Positions are world metres (x east, y north, z up); the floor is where it starts."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    id: str = Field(default="drone", min_length=1)
    system: int = Field(default=1, ge=1, le=255)
    flavour: Literal["ardupilot", "px4"] = "ardupilot"
    target: str | None = Field(default=None, pattern=r"^[^:\s]+:\d{1,5}$")
    """``host:port`` to which telemetry goes unasked, as from PX4 and SITL; without it the driver has to send first."""

    start_position_m: Point = (0.0, 0.0, 0.0)
    start_yaw_deg: float = 0.0
    origin_m: Point = (0.0, 0.0, 0.0)
    """Where the estimator's local origin lies in the world."""
    origin_latitude_deg: float = Field(default=47.397742, ge=-90.0, le=90.0)
    origin_longitude_deg: float = Field(default=8.545594, ge=-180.0, le=180.0)
    origin_altitude_m: float = 488.0

    max_speed_m_s: Positive = 2.0
    climb_speed_m_s: Positive = 1.0
    land_speed_m_s: Positive = 0.5
    acceleration_m_s2: Positive = 2.5
    yaw_rate_deg_s: Positive = 90.0
    land_disarm_s: NotNegative = 2.0
    """From touch-down to the automatic disarming."""

    hover_noise_m: NotNegative = 0.01
    """One sigma per axis of the true motion about the place it holds."""
    estimate_noise_m: NotNegative = 0.01
    """One sigma per axis of the slowly varying error of the reported position."""
    estimate_noise_deg: NotNegative = 0.1
    """One sigma per axis of the slowly varying error of the reported attitude."""
    telemetry_latency_s: NotNegative = 0.0
    """Age of what telemetry describes when it is sent; its time stamp is honest."""
    ready_after_s: NotNegative = 0.0
    """From boot to a valid estimate: before it there is no position, and arming is refused."""
