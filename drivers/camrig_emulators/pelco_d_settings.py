"""What an emulated Pelco-D head is like; degrees, as everything that a person writes."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Limits = tuple[float, float]


class AxisMap(BaseModel):
    """How an axis's angle (docs/frames-and-units.md) follows from the degrees on the wire, wrapped to +-180.

    ``angle = sign * scale * raw + offset_deg``. The right and down bits always turn towards growing raw.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sign: Literal[-1, 1] = -1
    scale: float = Field(default=1.0, gt=0.0)
    offset_deg: float = 0.0


class AxisMaps(BaseModel):
    """Both axes; the defaults are an upright head that counts clockwise and down (convention A)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pan: AxisMap = AxisMap()
    tilt: AxisMap = AxisMap()


class PelcoDHeadSettings(BaseModel):
    """One head. Angles are what its encoder reads; the optics are off by the play and the zero error.

    ``true = encoder -+ backlash_deg / 2 + zero_error_deg``, the sign being that of the last travel.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    address: int = Field(default=1, ge=1, le=254)
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    answers: Literal["none", "general", "queries", "full"] = Field(
        default="queries",
        description="none; general: 4 bytes to every command; queries: positions to queries; full: both",
    )
    start_pan_deg: float = 0.0
    start_tilt_deg: float = 0.0
    pan_limits_deg: Limits | None = Field(default=(-170.0, 170.0), description="null turns without end")
    tilt_limits_deg: Limits = (-90.0, 20.0)
    out_of_range: Literal["clamp", "ignore"] = Field(default="clamp", description="what a target outside limits does")
    max_speed_deg_s: float = Field(default=40.0, gt=0.0, description="of speed byte 3F and of moves to a position")
    acceleration_deg_s2: float = Field(default=160.0, gt=0.0)
    start_latency_s: float = Field(default=0.05, ge=0.0, description="from a command's last byte to motion, from rest")
    reply_latency_s: float = Field(default=0.01, ge=0.0, description="from a command's last byte to its answer's first")
    sample_fraction: float | None = Field(
        default=None, ge=0.0, le=1.0, description="where within reply_latency_s the angle is sampled; null: anywhere"
    )
    backlash_deg: float = Field(default=0.0, ge=0.0, description="play between encoder and optics, in total, per axis")
    zero_error_deg: tuple[float, float] = Field(default=(0.0, 0.0), description="pan and tilt: true minus reported")
    readback_step_deg: float = Field(default=0.01, gt=0.0)
    axes: AxisMaps = AxisMaps()
    dead_man_s: float | None = Field(default=None, gt=0.0, description="a jog ends by itself after so long")
    min_gap_s: float = Field(default=0.0, ge=0.0, description="commands closer to the one before go unheard")
    reset_s: float = Field(default=5.0, ge=0.0, description="deaf for so long after a remote reset")

    @model_validator(mode="after")
    def _starts_within_limits(self) -> PelcoDHeadSettings:
        for axis, start, limits in (
            ("pan", self.start_pan_deg, self.pan_limits_deg),
            ("tilt", self.start_tilt_deg, self.tilt_limits_deg),
        ):
            if limits is not None and not limits[0] <= start <= limits[1]:
                raise ValueError(
                    f"start_{axis}_deg {start:g} is outside {axis}_limits_deg {limits[0]:g} to {limits[1]:g}"
                )
        return self


class PelcoDEmulatorSection(PelcoDHeadSettings):
    """A line of like heads on one port, as ``camrig emulate pelco-d`` runs it."""

    id: str = "head"
    heads: int = Field(default=1, ge=1, le=32, description="how many, at addresses from address upwards")
    seed: int = 0

    @model_validator(mode="after")
    def _has_addresses_for_all(self) -> PelcoDEmulatorSection:
        if self.address + self.heads - 1 > 254:
            raise ValueError(f"{self.heads} heads from address {self.address} upwards go beyond the last address, 254")
        return self
