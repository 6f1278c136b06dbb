"""The keys that a MAVLink drone adds to those of a drone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from camrig.errors import InputError
from camrig.rig import DroneSpec
from camrig_drivers.mavlink.box import LEAST_CLIMB_M
from camrig_drivers.mavlink.packets import SetOrigin
from camrig_drivers.mavlink.watch import Needs
from camrig_drivers.mavlink.wire import WireUrl

_EMULATED = "emulated"
"""What stands for the url until an emulated world has opened its ports."""
_Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
_Share = Annotated[float, Field(ge=0.0, le=0.9)]


@dataclass(frozen=True, slots=True)
class VehicleSettings:
    """What a section says of one vehicle; ``floor_m`` is the height in the world on which it stands.

    ``origin`` is set as the autopilot's global origin where it has none.
    """

    stream_hz: float = 30.0
    needs: Needs = field(default_factory=Needs)
    gimbal: bool = False
    origin: SetOrigin | None = None
    floor_m: float = 0.0


class SigningSection(BaseModel):
    """MAVLink 2 signing: a file with the key, and a number of the link that no other link with this key has."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key_file: Path
    link: int = Field(default=0, ge=0, le=255)


class GlobeSection(BaseModel):
    """A place on the globe, for estimators that want one: any will do that is not 0, 0."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    latitude_deg: float = Field(default=47.397742, ge=-85.0, le=85.0)
    longitude_deg: float = Field(default=8.545594, ge=-180.0, le=180.0)
    altitude_m: float = Field(default=488.0, ge=-400.0, le=9000.0)


class MavlinkSection(BaseModel):
    """``origin_m`` is where the origin of the autopilot's local frame lies in the world; its north is the world's y.

    ``pose: vision``: it flies by poses that camrig takes from the anchors its camera sees. ``gimbal: down``: the camera
    hangs in a gimbal that is to look straight down; without, it is bolted to the airframe.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    system: int = Field(default=1, ge=1, le=254)
    component: int = Field(default=1, ge=1, le=254)
    origin_m: tuple[_Coordinate, _Coordinate, _Coordinate] = (0.0, 0.0, 0.0)
    floor_m: _Coordinate = 0.0
    pose: Literal["telemetry", "vision"] = "telemetry"
    gimbal: Literal["none", "down"] = "none"
    battery_land: _Share = 0.2
    stream_hz: float = Field(default=30.0, ge=5.0, le=100.0)
    signing: SigningSection | None = None
    globe: GlobeSection = GlobeSection()

    @field_validator("url")
    @classmethod
    def _is_url(cls, url: str) -> str:
        if url != _EMULATED:
            try:
                WireUrl.parse(url)
            except InputError as error:
                raise ValueError(str(error)) from error
        return url

    def settings(self, *, sets_origin: bool) -> VehicleSettings:
        """Return what concerns the vehicle; ``sets_origin``: its autopilot wants a global origin to fly by vision."""
        vision, globe = self.pose == "vision", self.globe
        origin = SetOrigin(globe.latitude_deg, globe.longitude_deg, globe.altitude_m)
        return VehicleSettings(
            stream_hz=self.stream_hz,
            needs=Needs(self.battery_land, vision),
            gimbal=self.gimbal == "down",
            origin=origin if vision and sets_origin else None,
            floor_m=self.floor_m,
        )


Drones = Mapping[str, tuple[DroneSpec, MavlinkSection]]


def check(drones: Drones) -> Sequence[tuple[str, str, str]]:
    """Return the faults that no section shows by itself."""
    return [*_one_system_each(drones), *_one_signature_each(drones), *_anchors(drones), *_floors(drones)]


def _one_system_each(drones: Drones) -> Iterator[tuple[str, str, str]]:
    first: dict[tuple[str, int], str] = {}
    for name, (_, section) in drones.items():
        owner = first.setdefault((section.url, section.system), name)
        if owner != name and section.url != _EMULATED:
            yield name, "system", f"system {section.system} on {section.url} is drone {owner} already"


def _one_signature_each(drones: Drones) -> Iterator[tuple[str, str, str]]:
    by_url: dict[str, SigningSection | None] = {}
    by_link: dict[tuple[Path, int], str] = {}
    for name, (_, section) in drones.items():
        signing = section.signing
        if by_url.setdefault(section.url, signing) != signing:
            yield name, "signing", f"another drone on {section.url} signs otherwise: a link has one key"
        elif signing is not None and by_link.setdefault((signing.key_file, signing.link), section.url) != section.url:
            yield name, "signing", f"link {signing.link} of key {signing.key_file} is on another url already"


def _anchors(drones: Drones) -> Iterator[tuple[str, str, str]]:
    for name, (spec, section) in drones.items():
        if section.pose == "vision" and not spec.needs_anchor:
            yield name, "pose", "vision needs anchors in view: say needs_anchor: true for this drone"
        if section.pose == "vision" and section.gimbal != "none":
            yield name, "gimbal", "vision needs a camera that is bolted to the airframe: gimbal: none"


def _floors(drones: Drones) -> Iterator[tuple[str, str, str]]:
    for name, (spec, section) in drones.items():
        (_, _, low_z), (_, _, high_z) = spec.box_m
        highest_m = min(low_z, high_z - LEAST_CLIMB_M)
        if section.floor_m > highest_m:
            yield (
                name,
                "floor_m",
                (
                    f"{section.floor_m:g} m is too high, {highest_m:g} m is the most: it stands below box_m and climbs "
                    f"{LEAST_CLIMB_M:g} m at least"
                ),
            )
