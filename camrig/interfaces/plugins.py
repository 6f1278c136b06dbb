"""What entry points name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from camrig.interfaces.emulated import World
from camrig.messages import HeadFindings
from camrig.rig import Rig

SpecT = TypeVar("SpecT")
DeviceT = TypeVar("DeviceT")


@dataclass(frozen=True, slots=True)
class Driver(Generic[SpecT, DeviceT]):
    """What an entry point names.

    ``section`` is a pydantic model (frozen, extra keys forbidden) of the keys that the driver adds to those of the
    rig itself. ``make`` gets ``{id: (spec, section)}`` of *all* devices of this driver, so that heads on one bus
    share one port, and returns ``{id: device}``; it opens nothing. ``check`` gets the same and returns
    ``(id, key, message)`` for every fault that no section shows by itself (two heads with one address, pictures of
    another size than the lens). ``discover`` lists what is plugged in, where a driver can; it never moves anything.
    """

    section: type[Any]
    make: Callable[[Mapping[str, tuple[SpecT, Any]]], Mapping[str, DeviceT]]
    check: Callable[[Mapping[str, tuple[SpecT, Any]]], Sequence[tuple[str, str, str]]] | None = None
    discover: Callable[[], Sequence[Found]] | None = None
    tuning: HeadTuning | None = None


@dataclass(frozen=True, slots=True)
class HeadTuning:
    """How a head's driver takes what its calibration found. Sections are the driver's own.

    ``plain`` returns the section of a head to be calibrated: it counts as the file says and reports its motor, without
    play, bend or age. ``changes`` returns what of the section is to be written, by path within the head's own keys.
    ``reads_back`` tells whether a head with that section tells its angles.
    """

    plain: Callable[[Any], Any]
    changes: Callable[[Any, HeadFindings], Mapping[tuple[str, ...], object]]
    reads_back: Callable[[Any], bool] = lambda _: True


@dataclass(frozen=True, slots=True)
class Found:
    """A device, or the port of one, that is plugged in, under the name that lasts longest. ``section`` is what a rig's
    file needs, ``size_px`` what a camera's pictures then have, ``facts`` all else, as it goes into JSON; ``trouble``
    says why it cannot be used now and, after a semicolon, what to do; empty where it can.
    """

    name: str
    title: str
    section: Mapping[str, object]
    size_px: tuple[int, int] | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Plugin(Generic[DeviceT]):
    """What an entry point of ``camrig.detectors``, ``.sinks``, ``.emulators`` or ``.painters`` names: one section, one
    thing.
    """

    section: type[Any]
    make: Callable[[Any], DeviceT]


@dataclass(frozen=True, slots=True)
class WorldPlugin:
    """What an entry point of ``camrig.worlds`` names.

    ``make(rig, section, devices)`` also gets the raw YAML of every camera source, head and drone by id, so that an
    emulated head answers at the address and baud its driver will use.
    """

    section: type[Any]
    make: Callable[[Rig, Any, Mapping[str, Mapping[str, Any]]], World]
