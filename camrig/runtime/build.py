"""From a checked configuration to devices and their jobs: each driver is handed all its sections at once."""

from __future__ import annotations

import threading
from collections.abc import Collection
from functools import partial
from typing import Any

from camrig.clock import Clock
from camrig.config.rig_file import DeviceConfig, DeviceGroup, RigConfig
from camrig.interfaces import Driver, Sink, TagDetector
from camrig.runtime.camera_job import CameraJob
from camrig.runtime.control import Devices
from camrig.runtime.drone_job import DroneJob, pilot
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.head_job import HeadJob


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


def make_jobs(
    config: RigConfig, clock: Clock, guardian: GuardianLink, news: threading.Event, held: Collection[str]
) -> Devices:
    """Build all devices, each with its job; ``news`` is set when a camera has found something, ``held`` heads wait."""
    detector = partial(make_detector, config)
    drones = {name: DroneJob(name, drone, clock) for name, drone in make_devices(config, "drones").items()}
    return Devices(
        cameras={
            name: CameraJob(
                name,
                camera,
                detector,
                clock,
                config.rig.cameras[name].lens,
                config.refine,
                told=pilot(name, config.rig, drones),
                news=news,
            )
            for name, camera in make_devices(config, "cameras").items()
        },
        heads={
            name: HeadJob(name, head, guardian, config.rig.heads[name].auto_enable and name not in held)
            for name, head in make_devices(config, "heads").items()
        },
        drones=drones,
    )
