"""From a checked configuration to devices: each driver is handed all its sections at once."""

from __future__ import annotations

from typing import Any

from camrig.config.rig_file import DeviceConfig, DeviceGroup, RigConfig
from camrig.interfaces import Driver, Sink, TagDetector


def make_devices(config: RigConfig, group: DeviceGroup) -> dict[str, Any]:
    """Build all cameras, heads or drones, by id; opens nothing. Heads on one bus share a port inside their driver."""
    specs: dict[DeviceGroup, dict[str, Any]] = {
        "cameras": dict(config.rig.cameras),
        "heads": dict(config.rig.heads),
        "drones": dict(config.rig.drones),
    }
    together: dict[str, tuple[Driver[Any, Any], dict[str, DeviceConfig]]] = {}
    for name, device in config.devices[group].items():
        together.setdefault(device.driver_name, (device.driver, {}))[1][name] = device
    made: dict[str, Any] = {}
    for driver, devices in together.values():
        made |= driver.make({name: (specs[group][name], device.section) for name, device in devices.items()})
    return made


def make_detector(config: RigConfig) -> TagDetector:
    """Build one tag detector; each camera's thread keeps its own."""
    detector: TagDetector = config.detector.plugin.make(config.detector.section)
    return detector


def make_sinks(config: RigConfig) -> list[Sink]:
    """Build the outputs of the configuration."""
    return [output.plugin.make(output.section) for output in config.outputs]
