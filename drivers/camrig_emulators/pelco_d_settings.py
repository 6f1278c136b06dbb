"""What an emulated Pelco-D head is like; degrees, as everything that a person writes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from camrig_emulators.pelco_d_speeds import Curve

Limits = tuple[float, float]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
LAST_ADDRESS = 254


class AxisMap(BaseModel):
    """How an axis's angle (docs/frames-and-units.md) follows from the degrees on the wire, wrapped to +-180.

    ``angle = sign * scale * raw + offset_deg``. The right and down bits always turn towards growing raw.
    """

    model_config = _STRICT

    sign: Literal[-1, 1] = -1
    scale: Positive = 1.0
    offset_deg: float = 0.0


class AxisMaps(BaseModel):
    """Both axes; the defaults are an upright head that counts clockwise and down (convention A)."""

    model_config = _STRICT

    pan: AxisMap = AxisMap()
    tilt: AxisMap = AxisMap()


class PelcoDHeadSettings(BaseModel):
    """One head. Angles are what its encoder reads; the optics are off by the play and the zero error.

    ``true = encoder -+ backlash_deg / 2 + zero_error_deg``, the sign being that of the last travel.
    """

    model_config = _STRICT

    id: str = Field(min_length=1)
    address: int = Field(default=1, ge=1, le=LAST_ADDRESS)
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    """Speed of the line; a port that is set to another one hears and says noise."""
    answers: Literal["none", "general", "queries", "full"] = "queries"
    """none; general: 4 bytes to every command; queries: positions to queries, else nothing; full: both."""
    start_pan_deg: float = 0.0
    start_tilt_deg: float = 0.0
    pan_limits_deg: Limits | None = (-170.0, 170.0)
    """null turns without end."""
    tilt_limits_deg: Limits = (-90.0, 20.0)
    out_of_range: Literal["clamp", "ignore"] = "clamp"
    """What becomes of a target outside the limits."""
    max_speed_deg_s: Positive = 40.0
    """Of moves to a position, and of speed byte 3F; slower bytes in proportion."""
    acceleration_deg_s2: Positive = 160.0
    start_latency_s: NotNegative = 0.05
    """From a command's last byte to motion, where the axis was at rest."""
    reply_latency_s: NotNegative = 0.01
    """From a command's last byte to its answer's first; the angle is sampled in between."""
    sample_fraction: float | None = Field(default=None, ge=0.0, le=1.0)
    """Where in reply_latency_s the angle is sampled; null: anywhere, another each time."""
    backlash_deg: NotNegative = 0.0
    """Play between encoder and optics, in total, of each axis."""
    zero_error_deg: tuple[float, float] = (0.0, 0.0)
    """True minus reported, of pan and of tilt."""
    readback_step_deg: Positive = 0.01
    """What an answer is rounded to."""
    axes: AxisMaps = AxisMaps()
    """How angles stand on the wire."""
    dead_man_s: Positive | None = None
    """A jog that is not repeated ends after so long; null: never."""
    min_gap_s: NotNegative = 0.0
    """A command that begins sooner after the one before is not heard."""
    reset_s: NotNegative = 5.0
    """A remote reset leaves the head deaf for so long; then it drives to where it started."""
    reset_shift_deg: float = 0.0
    """How much further from the truth its reports are after each reset."""

    hears_all: bool = False
    """Obey commands to any address, as a Bosch dome set to address 0."""
    hears_zero: bool = False
    """Obey address 0 as well, as a broadcast."""
    speed_zero: Literal["stop", "creep"] = "stop"
    """What a direction with speed 0 does; creep is 1/65 of full speed (FLIR D300E)."""
    turbo_byte: Literal[0x40, 0xFF] | None = None
    """Pan speed byte of turbo; others above 3F, and null, are full speed."""
    turbo_speed_deg_s: Positive = 150.0
    manual_speed_deg_s: Positive | None = None
    """Of speed byte 3F where it differs from max_speed_deg_s, which is then of moves to a position alone."""
    speed_curve: Curve = "linear"
    dead_bytes: int = Field(default=0, ge=0, le=62)
    """So many of the lowest speed bytes turn nothing."""
    speed_drift: float = Field(default=0.0, ge=0.0, le=0.3)
    """One sigma of each motion's speed, relative: supply, load and temperature."""
    zoom_slows: float = Field(default=0.0, ge=0.0, lt=1.0)
    """By how much of itself full zoom lowers the speed of jogs."""
    start_jitter_s: NotNegative = 0.0
    """Up to so much longer than start_latency_s, anything in between, before each motion."""
    breakaway_s: NotNegative = 0.0
    """How much longer still a motion takes to begin at a hard stop."""
    overshoot_deg: NotNegative = 0.0
    """How far a move to a position goes past it before it settles."""
    stop_error_deg: NotNegative = 0.0
    """How far at most from its position a move may end; it reports where it is."""
    pan_travel: Literal["nearest", "direct"] = "nearest"
    """Which way a pan without stops goes: the nearest, or never through raw 0."""
    auto_flip: bool = False
    """A tilt target beyond straight down turns pan by half a turn and comes up on the other side."""
    worm_error_deg: NotNegative = 0.0
    """Greatest periodic error of the gear, which reports do not show."""
    worm_period_deg: Positive = 4.0
    stall_loss_deg: NotNegative = 0.0
    """How many steps, in degrees, are lost whenever a jog runs into a hard stop."""
    update_s: NotNegative = 0.0
    """The reported angle is renewed once in so long; 0: always fresh."""
    reports: Literal["encoder", "target", "frozen"] = "encoder"
    """target: a moving head reports where it is going; frozen: where it last stood."""
    wraps: bool = True
    """false: what would be below raw 0 is reported as 0 (convention B)."""
    full_turn_as_36000: bool = False
    """Report 36000 for 0."""
    absolute: Literal["both", "pan", "tilt", "ignored", "race"] = "both"
    """Which positions it goes to; ignored ones are acknowledged all the same. race: the second ends the first's."""
    own_sum: bool = False
    """General replies sum their own bytes, not the command's."""
    half_duplex: bool = False
    """What comes while it answers, or turns round, is not heard."""
    turn_around_s: NotNegative = 0.0
    """How long after an answer it is still deaf, on a half-duplex line."""
    lost_first: int = Field(default=0, ge=0, le=3)
    """So many first bytes of each answer are lost while the adapter still drives the line."""
    zoom_limit: int = Field(default=0xFFFF, ge=1, le=0xFFFF)
    """Greatest zoom position."""
    zoom_s: Positive = 3.0
    """From one end of the zoom to the other."""
    greatest_magnification: float = Field(default=20.0, ge=1.0, le=655.0)
    opcode_5f: Literal["magnification", "focus"] = "magnification"
    """What 5F sets and 61 asks."""

    @model_validator(mode="after")
    def _starts_within_limits(self) -> PelcoDHeadSettings:
        for axis, start, limits in (
            ("pan", self.start_pan_deg, self.pan_limits_deg),
            ("tilt", self.start_tilt_deg, self.tilt_limits_deg),
        ):
            if limits is not None and not limits[0] <= start <= limits[1]:
                allowed = f"{axis}_limits_deg {limits[0]:g} to {limits[1]:g}"
                raise ValueError(f"start_{axis}_deg {start:g} is outside {allowed}")
        return self


class PelcoDEmulatorSection(PelcoDHeadSettings):
    """A line of like heads on one port, as ``camrig emulate pelco-d`` runs it."""

    id: str = Field(default="head", min_length=1)
    heads: int = Field(default=1, ge=1, le=32)
    """How many, at the addresses from the given one upwards."""
    seed: int = 0
    script: str = ""
    """What goes wrong and when, in statements with ';' between: 'at 5 unplug; at 8 replug; from 10 to 12 silent'."""

    @model_validator(mode="after")
    def _has_addresses_for_all(self) -> PelcoDEmulatorSection:
        if self.address + self.heads - 1 > LAST_ADDRESS:
            raise ValueError(f"{self.heads} heads from address {self.address} upwards go beyond {LAST_ADDRESS}")
        return self
