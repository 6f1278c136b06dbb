"""The keys of a ``driver: visca`` head in the YAML."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from camrig.rig import HeadSpec
from camrig_drivers.visca.codec import Digits

_STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_UDP = "udpout"


class ViscaAxisSection(BaseModel):
    """How one axis counts: ``deg = sign * deg_per_count * count + offset_deg``."""

    model_config = _STRICT

    deg_per_count: Annotated[float, Field(gt=0.0, le=1.0)]
    """No default: a wrong one would shift the limits. docs/visca.md lists those of common cameras."""
    sign: Literal[-1, 1]
    """Pan: -1 where counts grow to the right. Tilt: +1 where they grow upwards."""
    offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    digits: Literal[4, 5] = 4
    """Hexadecimal digits of a position in messages."""
    backlash_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Full width of the play between the reported and the true axis; it widens the sigma of a reading."""


class ViscaAxesSection(BaseModel):
    """Both axes."""

    model_config = _STRICT

    pan: ViscaAxisSection
    tilt: ViscaAxisSection


class ViscaSection(BaseModel):
    """One head on a serial line or on UDP."""

    model_config = _STRICT

    port: Annotated[str, Field(min_length=1)]
    """A serial device, or ``udpout://host:port``."""
    baud: Literal[2400, 4800, 9600, 19200, 38400, 115200] = 9600
    address: Annotated[int, Field(ge=1, le=7)] = 1
    header: bool = True
    """On UDP: Sony's header with sequence numbers goes before every message (port 52381); PTZOptics has none (1259)."""
    axes: ViscaAxesSection
    counts: Literal["signed", "unsigned"] = "signed"
    pan_speed: Annotated[int, Field(ge=1, le=24)] = 24
    tilt_speed: Annotated[int, Field(ge=1, le=24)] = 20
    zoom: Annotated[int, Field(ge=0, le=0x7FFF)] | None = None
    """The zoom position at which the lens was calibrated: set with the first move after each enabling."""
    readback_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.02
    """One sigma of a reported angle, beyond its last digit."""
    reply_timeout_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.2
    """From a message's last byte until its answer has come in full."""
    gap_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """From an answer to the next message."""

    @property
    def digits(self) -> Digits:
        """How positions stand in messages."""
        return Digits(self.axes.pan.digits, self.axes.tilt.digits, self.counts == "signed")

    @property
    def udp(self) -> tuple[str, int] | None:
        """Host and port of a head on UDP; None of a serial one."""
        return _udp(self.port)

    @field_validator("port")
    @classmethod
    def _is_a_port(cls, value: str) -> str:
        _udp(value)
        return value

    @model_validator(mode="after")
    def _address_of_udp(self) -> ViscaSection:
        if self.udp and self.address != 1:
            raise ValueError(f"a head on UDP has address 1, not {self.address}; leave `address` out")
        return self


def _udp(port: str) -> tuple[str, int] | None:
    if "://" not in port:
        return None
    parts = urlsplit(port)
    try:
        number = parts.port
    except ValueError:
        number = None
    if parts.scheme != _UDP or not parts.hostname or not number or parts.path or parts.query:
        raise ValueError(f"'{port}' must be a serial device or {_UDP}://host:port, as in {_UDP}://192.168.0.20:52381")
    return parts.hostname, number


def line_of(section: ViscaSection) -> str:
    """Return what stands for the line, so that two names of one meet."""
    return section.port if section.udp else os.path.realpath(section.port)


def check(heads: Mapping[str, tuple[HeadSpec, ViscaSection]]) -> Sequence[tuple[str, str, str]]:
    """Return the faults that a section shows only beside its head or the others, as (id, key, message)."""
    faults: list[tuple[str, str, str]] = []
    seen: dict[str, list[str]] = {}
    for name, (spec, section) in heads.items():
        others = seen.setdefault(line_of(section), [])
        faults += [(name, key, text) for key, text in _against(section, [(each, heads[each][1]) for each in others])]
        faults += [(name, key, text) for key, text in _unsayable(spec, section)]
        others.append(name)
    return faults


def _against(section: ViscaSection, others: Sequence[tuple[str, ViscaSection]]) -> Sequence[tuple[str, str]]:
    """Compare a head with the heads before it on its line."""
    if section.udp:
        return [("port", f"{section.port} is already the port of head {name}") for name, _ in others][:1]
    faults = [
        ("address", f"address {section.address} is taken by head {name} on the same port; give each its own, 1..7")
        for name, other in others
        if other.address == section.address
    ][:1]
    faults += [
        ("baud", f"is {section.baud} here and {first.baud} for head {name} on the same port")
        for name, first in others[:1]
        if first.baud != section.baud
    ]
    return faults


def _unsayable(spec: HeadSpec, section: ViscaSection) -> Sequence[tuple[str, str]]:
    """Find limits that the digits of a message cannot say."""
    faults = []
    for key, limits_rad, axis in (
        ("pan_deg", spec.pan_limits_rad, section.axes.pan),
        ("tilt_deg", spec.tilt_limits_rad, section.axes.tilt),
    ):
        low, high = section.digits.range(axis.digits)
        ends = sorted(axis.sign * axis.deg_per_count * count + axis.offset_deg for count in (low, high))
        slack_deg = axis.deg_per_count
        if math.degrees(limits_rad[0]) < ends[0] - slack_deg or math.degrees(limits_rad[1]) > ends[1] + slack_deg:
            faults.append((key, f"limits reach beyond the {ends[0]:.1f}..{ends[1]:.1f} deg that its counts can say"))
    return faults
