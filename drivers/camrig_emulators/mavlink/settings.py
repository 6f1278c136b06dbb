"""The section of an emulated MAVLink drone."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from camrig_emulators.mavlink.params import PARAMETERS_OF, RELEASES

Point = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

_MEASURED: dict[str, dict[str, float]] = {
    "ardupilot": {
        "acceleration_m_s2": 0.8,
        "climb_speed_m_s": 0.6,
        "yaw_rate_deg_s": 60.0,
        "hover_noise_m": 0.015,
        "ready_after_s": 11.0,
        "vision_converges_s": 0.05,
    },
    "px4": {
        "acceleration_m_s2": 0.6,
        "climb_speed_m_s": 0.6,
        "land_speed_m_s": 0.27,
        "yaw_rate_deg_s": 150.0,
        "hover_noise_m": 0.13,
        "estimate_wander_m": 0.4,
        "ready_after_s": 3.0,
        "vision_converges_s": 6.5,
    },
}
"""What ArduCopter 4.7 and PX4 1.17 were seen to do in their own simulators, as far as it differs from the defaults."""


class MavlinkDroneSettings(BaseModel):
    """One emulated drone. Positions are world metres (x east, y north, z up); the floor is where it starts."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    id: str = Field(default="drone", min_length=1, pattern=r"^[^/\s]+$")
    """Its name, also the last part of a serial port's path."""
    system: int = Field(default=1, ge=1, le=255)
    """MAVLink system id; its component id is 1."""
    flavour: Literal["ardupilot", "px4"] = "ardupilot"
    """Whose habits: ArduCopter's (GUIDED) or PX4's (OFFBOARD)."""
    release: str | None = None
    """ardupilot 4.5, 4.6 or 4.7, which differ in names of parameters; px4 1.17. The newest where left out."""

    transport: Literal["udp", "tcp", "serial"] = "udp"
    """udp and tcp serve a port of 127.0.0.1; serial is a pseudo-terminal."""
    port: int = Field(default=0, ge=0, le=65535)
    """UDP or TCP port to serve; 0 takes a free one."""
    target: str | None = None
    """UDP only: host:port to which telemetry goes unasked, as from PX4; otherwise it waits to be spoken to."""
    baud: Literal[57600, 115200, 230400] = 115200
    """Of a serial port; telemetry thins out to what fits through."""
    usb: str | None = Field(default=None, pattern=r"^/.+")
    """Path to make for a second, serial port: ArduPilot's channel 0, which never asks for signatures."""

    start_position_m: Point = (0.0, 0.0, 0.0)
    """Where it stands; the floor is at its z."""
    start_yaw_deg: float = 0.0
    """Its heading: 0 is east, 90 north."""
    origin_m: Point = (0.0, 0.0, 0.0)
    """Where the estimator's local origin lies in the world."""
    origin_latitude_deg: float = Field(default=47.397742, ge=-90.0, le=90.0)
    """Of the local origin on the globe."""
    origin_longitude_deg: float = Field(default=8.545594, ge=-180.0, le=180.0)
    """Of the local origin on the globe."""
    origin_altitude_m: float = 488.0
    """Of the local origin, above the sea."""

    figures: Literal["brisk", "measured"] = "brisk"
    """brisk: quick and calm. measured: speeds, noise and waiting times of the real autopilot, where not given here."""
    max_speed_m_s: Positive = 2.0
    """Horizontal limit."""
    climb_speed_m_s: Positive = 1.0
    """Vertical limit."""
    land_speed_m_s: Positive = 0.5
    """Of the last metres of a landing."""
    acceleration_m_s2: Positive = 2.5
    """Limit, horizontal and vertical."""
    yaw_rate_deg_s: Positive = 90.0
    """Limit of turning."""
    land_disarm_s: NotNegative = 2.0
    """From touch-down to the automatic disarming."""
    battery: float = Field(default=1.0, ge=0.0, le=1.0)
    """Charge at the start; a full one lasts 20 minutes."""

    hover_noise_m: NotNegative = 0.01
    """One sigma per axis of the true motion about the place it holds."""
    estimate_noise_m: NotNegative = 0.01
    """One sigma per axis of the slowly varying error of the reported position."""
    estimate_wander_m: NotNegative = 0.0
    """One sigma per axis of the error that simulated GPS leaves, which changes over a minute."""
    estimate_noise_deg: NotNegative = 0.1
    """One sigma per axis of the slowly varying error of the reported attitude."""
    telemetry_latency_s: NotNegative = 0.0
    """Age of what telemetry describes when it is sent; its time stamp is honest."""
    ready_after_s: NotNegative = 0.0
    """From boot to a valid estimate by GPS: before it there is no position, and arming is refused."""
    vision_converges_s: NotNegative = 0.05
    """From the first pose sent to it to a valid estimate, where it flies by vision."""

    params: dict[str, float] = {}
    """Parameters that differ from the firmware's defaults at the first boot: params={MNT1_TYPE: 1}."""
    streams_hz: dict[int, Positive] = {}
    """Messages by number that go out unasked besides the firmware's own: streams_hz={1: 2, 32: 10}."""
    script: str = ""
    """What goes wrong and when: at 5 reboot; from 8 to 12 no_pose. See docs/mavlink-emulator.md."""

    seed: int = 0
    """Of the noise; the same seed and the same commands give the same flight."""

    @field_validator("target")
    @classmethod
    def _is_address(cls, target: str | None) -> str | None:
        if target is not None and re.fullmatch(r"[^:\s]+:\d{1,5}", target) is None:
            raise ValueError(f"{target!r} is no host:port; write for example 127.0.0.1:14540")
        return target

    @model_validator(mode="before")
    @classmethod
    def _filled_in(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        measured = _MEASURED.get(data.get("flavour", "ardupilot"), {}) if data.get("figures") == "measured" else {}
        release = data.get("release")  # YAML reads a number
        return {**measured, **data, **({"release": str(release)} if isinstance(release, float) else {})}

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        releases = RELEASES[self.flavour]
        if self.release is not None and self.release not in releases:
            raise ValueError(
                f"release {self.release} of {self.flavour} is not emulated; there are {', '.join(releases)}"
            )
        if self.target is not None and self.transport != "udp":
            raise ValueError(f"a target is spoken to over udp, not over {self.transport}: leave out one of the two")
        if self.port and self.transport == "serial":
            raise ValueError("a serial port has no number: leave out port, or give transport tcp or udp")
        unknown = self.params.keys() - PARAMETERS_OF[self.flavour, self.release or releases[-1]].keys()
        if unknown:
            raise ValueError(f"{self.flavour} has no emulated parameter {', '.join(sorted(unknown))}")
        return self
