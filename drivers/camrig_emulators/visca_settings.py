"""What an emulated VISCA head is like; degrees, as everything that a person writes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Limits = tuple[float, float]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
LAST_ADDRESS = 7


class ViscaAxisMap(BaseModel):
    """How an axis's angle (docs/frames-and-units.md) follows from the counts on the wire.

    ``angle = sign * deg_per_count * count + offset_deg``. Left and up are always what they say.
    """

    model_config = _STRICT

    deg_per_count: Positive = 0.075
    sign: Literal[-1, 1] = 1
    offset_deg: float = 0.0
    digits: Literal[4, 5] = 4
    """Hexadecimal digits of a position on the wire."""


class ViscaAxisMaps(BaseModel):
    """Both axes; the defaults are an EVI-D70's, whose counts grow to the right and upwards."""

    model_config = _STRICT

    pan: ViscaAxisMap = ViscaAxisMap(sign=-1)
    tilt: ViscaAxisMap = ViscaAxisMap()


class ViscaHeadSettings(BaseModel):
    """One head. Angles are what its encoder reads; the optics are off by the play and the zero error.

    ``true = encoder -+ backlash_deg / 2 + zero_error_deg``, the sign being that of the last travel.
    """

    model_config = _STRICT

    id: str = Field(min_length=1)
    address: int = Field(default=1, ge=1, le=LAST_ADDRESS)
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    """Speed of a serial line; a port that is set to another one hears and says noise."""
    start_pan_deg: float = 0.0
    start_tilt_deg: float = 0.0
    pan_limits_deg: Limits = (-170.0, 170.0)
    tilt_limits_deg: Limits = (-90.0, 30.0)
    out_of_range: Literal["refuse", "clamp"] = "refuse"
    """What becomes of a target outside the limits: error 41, or the limit."""
    max_speed_deg_s: Positive = 40.0
    """Of the highest speed byte; slower bytes in proportion."""
    acceleration_deg_s2: Positive = 160.0
    start_latency_s: NotNegative = 0.05
    """From a command's last byte to motion, where the axis was at rest."""
    reply_latency_s: NotNegative = 0.016
    """From a message's last byte to its answer's first; the angle is sampled in between."""
    sample_fraction: float | None = Field(default=None, ge=0.0, le=1.0)
    """Where in reply_latency_s the angles are sampled; null: anywhere, another each time."""
    acknowledges: bool = True
    """false: commands are completed, but not acknowledged before."""
    overtaking: Literal["replace", "queue", "refuse"] = "replace"
    """What a position command does to one that is under way: take its place, wait for it, or get error 41."""
    reports: Literal["position", "target"] = "position"
    """target: while moving it reports where it is going to."""
    rest_error_deg: NotNegative = 0.0
    """How far beside its target a motion may end, anew each time: motors rest between counts."""
    backlash_deg: NotNegative = 0.0
    """Play between encoder and optics, in total, of each axis."""
    zero_error_deg: tuple[float, float] = (0.0, 0.0)
    """True minus reported, of pan and of tilt."""
    axes: ViscaAxisMaps = ViscaAxisMaps()
    """How angles stand on the wire."""
    standby: bool = False
    """In standby it answers error 41 to whatever concerns pan, tilt and zoom."""
    zoom_s: NotNegative = 2.0
    """What the lens takes from one end of its zoom to the other; the command holds a socket until then."""
    reset_s: NotNegative = 5.0
    """A reset leaves the head deaf for so long, then it goes home."""

    @model_validator(mode="after")
    def _starts_within_limits(self) -> ViscaHeadSettings:
        for axis, start, limits in (
            ("pan", self.start_pan_deg, self.pan_limits_deg),
            ("tilt", self.start_tilt_deg, self.tilt_limits_deg),
        ):
            if not limits[0] <= start <= limits[1]:
                raise ValueError(
                    f"start_{axis}_deg {start:g} is outside {axis}_limits_deg {limits[0]:g} to {limits[1]:g}"
                )
        return self


Transport = Literal["serial", "udp", "raw-udp"]


class ViscaEmulatorSection(ViscaHeadSettings):
    """Like heads on one serial line, or one head on UDP, as ``camrig emulate visca`` runs them."""

    id: str = Field(default="head", min_length=1)
    transport: Transport = "serial"
    """serial: a pseudo-terminal; udp: with Sony's 8-byte header; raw-udp: without it."""
    heads: int = Field(default=1, ge=1, le=LAST_ADDRESS)
    """How many, at the addresses from the given one upwards."""
    seed: int = 0

    @model_validator(mode="after")
    def _has_addresses_for_all(self) -> ViscaEmulatorSection:
        if self.address + self.heads - 1 > LAST_ADDRESS:
            raise ValueError(f"{self.heads} heads from address {self.address} upwards go beyond {LAST_ADDRESS}")
        if self.transport != "serial" and (self.heads, self.address) != (1, 1):
            raise ValueError(f"transport {self.transport} carries one head, and its address is always 1")
        return self
