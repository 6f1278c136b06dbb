"""From a checked configuration to devices at work: each with its job."""

from __future__ import annotations

import threading
from collections.abc import Collection
from functools import partial

from camrig.clock import Clock
from camrig.config.rig_file import RigConfig
from camrig.runtime.build import make_detector, make_devices
from camrig.runtime.camera_job import CameraJob
from camrig.runtime.control import Devices
from camrig.runtime.drone_job import DroneJob, pilot
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.head_job import HeadJob


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
