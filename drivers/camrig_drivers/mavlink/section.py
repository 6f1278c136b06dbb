"""The keys that a MAVLink drone adds to those of a drone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from camrig.errors import InputError
from camrig.rig import DroneSpec
from camrig_drivers.udp import Endpoint

_EMULATED = "emulated"
"""What stands for the url until an emulated world has opened its ports."""
_Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]


class MavlinkSection(BaseModel):
    """``origin_m`` is where the origin of the autopilot's local frame lies in the world; its north is the world's y."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    system: int = Field(default=1, ge=1, le=254)
    component: int = Field(default=1, ge=1, le=254)
    origin_m: tuple[_Coordinate, _Coordinate, _Coordinate] = (0.0, 0.0, 0.0)
    pose: Literal["telemetry", "vision"] = "telemetry"
    stream_hz: float = Field(default=30.0, ge=5.0, le=100.0)

    @field_validator("url")
    @classmethod
    def _is_url(cls, url: str) -> str:
        if url != _EMULATED:
            try:
                Endpoint.parse(url)
            except InputError as error:
                raise ValueError(str(error)) from error
        return url

    @field_validator("pose")
    @classmethod
    def _is_telemetry(cls, pose: str) -> str:
        if pose == "vision":
            raise ValueError("vision is not supported yet: use telemetry, the autopilot's own estimate")
        return pose


def check(drones: Mapping[str, tuple[DroneSpec, MavlinkSection]]) -> Sequence[tuple[str, str, str]]:
    """Return a fault for every drone that answers to the same system on the same url as one before it."""
    faults = []
    first: dict[tuple[str, int], str] = {}
    for name, (_, section) in drones.items():
        owner = first.setdefault((section.url, section.system), name)
        if owner != name and section.url != _EMULATED:
            faults.append((name, "system", f"system {section.system} on {section.url} is drone {owner} already"))
    return faults
