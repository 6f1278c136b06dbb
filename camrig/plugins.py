"""Finds drivers, detectors, sinks, worlds, emulators, painters by entry point; imports only the one asked for."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, TypeVar

from camrig.errors import InputError
from camrig.interfaces import Driver, Plugin, WorldPlugin

KindT = TypeVar("KindT")

Group = Literal["cameras", "detectors", "heads", "drones", "sinks", "worlds", "emulators", "painters"]


def names(group: Group) -> tuple[str, ...]:
    """Return the names that are installed in a group, sorted."""
    return tuple(sorted(_installed(group)))


def load_driver(group: Literal["cameras", "heads", "drones"], name: str) -> Driver[Any, Any]:
    """Import a device driver; raises InputError for a name that is not installed."""
    return _load(group, name, Driver)


def load_plugin(group: Literal["detectors", "sinks", "emulators", "painters"], name: str) -> Plugin[Any]:
    """Import a detector, sink, emulator or painter; raises InputError for a name that is not installed."""
    return _load(group, name, Plugin)


def load_world(name: str) -> WorldPlugin:
    """Import an emulated world; raises InputError for a name that is not installed."""
    return _load("worlds", name, WorldPlugin)


def _installed(group: Group) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=f"camrig.{group}")}


def _load(group: Group, name: str, kind: type[KindT]) -> KindT:
    installed = _installed(group)
    if name not in installed:
        known = ", ".join(sorted(installed)) or "none"
        raise InputError(f"no driver '{name}' among the installed {group}; installed: {known}")
    try:
        plugin = installed[name].load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"the driver '{name}' of {group} cannot be loaded: {error}") from error
    if not isinstance(plugin, kind):
        raise InputError(f"entry point camrig.{group}:{name} is no camrig.interfaces.{kind.__name__}")
    return plugin
