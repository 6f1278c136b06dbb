"""An emulated camera drone on UDP with the habits of ArduCopter or PX4.

Vehicle (dynamics and firmware, ``mavlink_vehicle``), protocol (``mavlink_protocol``) and port (``udp_port``) are
three things; the first two run in simulated time without a socket. It shares no code with the driver.
"""

from __future__ import annotations

import math
import socket
import threading

from camrig.clock import Clock, RealClock
from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.interfaces import Plugin
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.protocol import MavlinkProtocol, Received
from camrig_emulators.mavlink.settings import MavlinkDroneSettings
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.udp_port import Address, UdpPort

__all__ = ["MavlinkDrone", "MavlinkDroneSettings", "Received", "emulator"]

_CLOCK_SLACK_S = 0.02


class MavlinkDrone:
    """An ``Emulator``; also gives the truth and what it has heard. Everything may be called from any thread."""

    def __init__(self, settings: MavlinkDroneSettings, *, clock: Clock | None = None, seed: int = 0) -> None:
        self.settings = settings
        self.faults = Faults()
        self._clock = RealClock() if clock is None else clock
        self._seed = seed
        self._lock = threading.Lock()
        self._protocol = self._power_up(None)
        self._port: UdpPort | None = None

    def start(self) -> str:
        """Power up and serve; returns the driver's url. Raises InputError for a target that is no address."""
        if self._port is not None:
            return self._url()
        target = None if self.settings.target is None else _address(self.settings.target)
        self._protocol = self._power_up(target)
        name = f"emulated {self.settings.id}"
        self._port = UdpPort(name, self._protocol, self._lock, self._clock, self.faults, self._seed)
        return self._url()

    def describe(self) -> str:
        with self._lock:
            vehicle = self._protocol.vehicle
            vehicle.advance_to(self._clock.now_s())
            truth, cockpit = vehicle.history.latest.truth, vehicle.cockpit
            peers = self._protocol.listeners(self._clock.now_s())
            x, y, z = truth.position_m
            state = "armed" if cockpit.armed else "disarmed"
            place = (
                f"({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {math.degrees(math.remainder(truth.yaw_rad, math.tau)):.0f} deg"
            )
            mode = f"{self.settings.flavour} {vehicle.firmware.mode_name}"
            return f"{self.settings.id}: {mode}, {state}, {place}, {peers} peers"

    def stop(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def T_world_body(self, stamp_s: float) -> Transform:
        """Return the true pose at a stamp of the last 20 s; the same stamp always gives the same pose.

        Raises ValueError for a stamp that is older, or in the future.
        """
        with self._lock:
            if stamp_s > self._clock.now_s() + _CLOCK_SLACK_S:
                raise ValueError(f"{stamp_s:.3f} s is in the future")
            return self._protocol.vehicle.T_world_body(stamp_s)

    @property
    def received(self) -> list[Received]:
        """What it has heard, oldest first (the newest 50 000)."""
        with self._lock:
            return list(self._protocol.received)

    def _power_up(self, target: Address | None) -> MavlinkProtocol:
        vehicle = Vehicle(self.settings, self._clock.now_s(), self._seed)
        return MavlinkProtocol(vehicle, self.faults, self._seed, target)

    def _url(self) -> str:
        if self.settings.target is not None:
            return f"udp://{self.settings.target}"
        return f"udpout://127.0.0.1:{self._port.port if self._port is not None else 0}"


def _address(target: str) -> Address:
    host, port = target.rsplit(":", 1)
    try:
        return socket.gethostbyname(host), int(port)
    except OSError as error:
        raise InputError(f"target {target}: {host} is no host; give host:port, for example 127.0.0.1:14540") from error


emulator: Plugin[MavlinkDrone] = Plugin(section=MavlinkDroneSettings, make=MavlinkDrone)
