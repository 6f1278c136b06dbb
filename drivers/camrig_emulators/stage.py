"""Everything that lives in the world's process: emulated heads and drones, the scenery, and a server per camera."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from camrig.clock import Clock
from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage, Transform
from camrig_emulators import world_settings
from camrig_emulators.backdrop import Backdrop
from camrig_emulators.carriers import camera_pose
from camrig_emulators.faults import Faults
from camrig_emulators.frame_server import FrameGrid, FrameServer
from camrig_emulators.lens_rays import LensRays, lens_rays
from camrig_emulators.mavlink_drone import MavlinkDrone
from camrig_emulators.pelco_d_head import PelcoDLine
from camrig_emulators.renderer import Renderer, Sensor, Shot
from camrig_emulators.scenery import Scenery
from camrig_emulators.sprites import painting_order
from camrig_emulators.world_wire import Job, Ready, SetFault


class Stage:
    """Built and started by ``start``; ``camera_pose`` and ``set_fault`` may then be called from any thread."""

    def __init__(self, job: Job, clock: Clock) -> None:
        """Build all devices, opening nothing yet; raises InputError for what cannot be emulated."""
        self._job = job
        self._clock = clock
        self._running = ExitStack()
        section, devices = job.section, job.devices
        self._rig = rig = world_settings.true_rig(job.rig, section)
        self._scenery = Scenery(rig, job.motions)
        self._lines = [
            ([head.id for head in heads], PelcoDLine(heads, clock=clock, seed=section.seed + number, name=heads[0].id))
            for number, heads in enumerate(world_settings.head_lines(rig, section, devices))
        ]
        self._line_of = {name: line for names, line in self._lines for name in names}
        self._drones = {
            settings.id: MavlinkDrone(settings, clock=clock, seed=section.seed + number)
            for number, settings in enumerate(world_settings.drones(rig, section, devices))
        }
        self._fps = world_settings.rendered_cameras(rig, devices)
        self._servers: dict[str, FrameServer] = {}
        self._renderers = dict(zip(self._fps, self._make_renderers(), strict=True))
        self._epoch_s = 0.0

    def start(self) -> Ready:
        """Start every device; the world's time begins when all are up."""
        ports: dict[str, str] = {}
        for names, line in self._lines:
            self._running.callback(line.stop)
            ports |= dict.fromkeys(names, line.start())
        for name, drone in self._drones.items():
            self._running.callback(drone.stop)
            ports[name] = drone.start()
        self._epoch_s = self._clock.now_s()
        for number, name in enumerate(self._fps):
            self._servers[name] = server = self._serve(name, number)
            server.start()
            self._running.callback(server.stop)
            ports[name] = server.url
        return Ready(ports, self._epoch_s)

    def stop(self) -> None:
        """Stop every device, the last one first; twice is allowed."""
        self._running.close()

    def camera_pose(self, camera_id: str, stamp_s: float) -> Transform:
        """Return the true ``T_world_camera`` at a stamp that the devices still remember."""
        return camera_pose(self._rig, camera_id, stamp_s, self._true_angles_rad, self._true_body)

    def set_fault(self, fault: SetFault) -> None:
        """Set a fault of one device; a head is unplugged with its whole line. Raises InputError for a stranger."""
        drone = self._drones.get(fault.device_id)
        if fault.name == "happen" and drone is None:
            raise InputError(
                f"the emulated world has no drone {fault.device_id}; it has {', '.join(self._drones) or 'none'}"
            )
        if drone is not None and fault.name in ("happen", "clear"):
            drone.happen(str(fault.arguments[0]) if fault.arguments else "clear")
            return
        for faults in self._faults_of(fault):
            if fault.name in ("silent", "freeze", "echo", "latency_s"):
                setattr(faults, fault.name, fault.arguments[0])
            else:
                getattr(faults, fault.name)(*fault.arguments)

    def _faults_of(self, fault: SetFault) -> list[Faults]:
        name = fault.device_id
        if name in self._line_of:
            line = self._line_of[name]
            own, shared = line.head_faults[name], line.faults
            if fault.name == "clear":
                return [own, shared]
            return [shared if fault.name in ("unplug", "replug", "echo") else own]
        device = self._drones.get(name) or self._servers.get(name)
        if device is None:
            known = ", ".join([*self._line_of, *self._drones, *self._servers])
            raise InputError(f"the emulated world has no device {name}; it has {known}")
        return [device.faults]

    def _true_angles_rad(self, head_id: str, stamp_s: float) -> tuple[float, float]:
        return self._line_of[head_id].true_angles_rad(head_id, stamp_s)

    def _true_body(self, drone_id: str, stamp_s: float) -> Transform:
        return self._drones[drone_id].T_world_body(stamp_s)

    def _make_renderers(self) -> list[Renderer]:
        section = self._job.section
        sensor = Sensor(section.exposure_s, section.noise_grey, section.psf_px)
        tables: dict[int, LensRays] = {}
        renderers = []
        for number, name in enumerate(self._fps):
            lens = self._rig.cameras[name].lens
            if id(lens) not in tables:
                tables[id(lens)] = lens_rays(lens)
            rays = tables[id(lens)]
            renderers.append(Renderer(rays, Backdrop(rays), sensor, section.seed + number))
        return renderers

    def _serve(self, name: str, number: int) -> FrameServer:
        """Build a camera's server; the cameras expose one after another, not all at once."""
        period_s = 1.0 / self._fps[name]
        first_s = self._epoch_s + period_s * (1.0 + number / len(self._fps))
        grid = FrameGrid(first_s, period_s, self._job.section.exposure_s)
        path = Path(self._job.folder) / f"camera{number}"
        return FrameServer(name, path, grid, partial(self._draw, name), self._clock)

    def _draw(self, name: str, stamp_s: float, sequence: int) -> GreyImage:
        return self._renderers[name].render(partial(self._shot, name), stamp_s, sequence)

    def _shot(self, name: str, stamp_s: float) -> Shot:
        T_world_camera = self.camera_pose(name, stamp_s)
        scenery = self._scenery
        robots = scenery.robots(stamp_s - self._epoch_s + self._job.section.start_s)
        eye_m = np.asarray(T_world_camera[:3, 3])
        order = painting_order(scenery.anchors, robots, scenery.boxes, scenery.box_limits_m, eye_m)
        return Shot(T_world_camera, order)
