"""Everything that the installed drivers find plugged in. Opens cameras for a moment; moves nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from camrig import plugins
from camrig.interfaces import Found


@dataclass(frozen=True, slots=True)
class Device:
    """A device and the drivers that it may be used with."""

    drivers: tuple[str, ...]
    found: Found


@dataclass(frozen=True, slots=True)
class PluggedIn:
    """Cameras, and the ports that heads may hang on."""

    cameras: tuple[Device, ...]
    ports: tuple[Device, ...]


def plugged_in() -> PluggedIn:
    """Ask every installed driver of cameras and heads. Raises InputError for a driver that cannot be loaded."""
    return PluggedIn(_ask("cameras"), _ask("heads"))


def _ask(group: Literal["cameras", "heads"]) -> tuple[Device, ...]:
    """List devices by name; one that several drivers name is one device."""
    devices: dict[str, Device] = {}
    for driver in plugins.names(group):
        for found in _found(group, driver):
            known = devices.get(found.name)
            devices[found.name] = Device((*known.drivers, driver), known.found) if known else Device((driver,), found)
    return tuple(devices.values())


def _found(group: Literal["cameras", "heads"], driver: str) -> Sequence[Found]:
    discover = plugins.load_driver(group, driver).discover
    return discover() if discover is not None else ()
