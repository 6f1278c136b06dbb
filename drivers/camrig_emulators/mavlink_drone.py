"""An emulated camera drone on UDP, TCP or a serial line with the habits of ArduCopter or PX4.

Vehicle (dynamics, estimator and firmware, ``mavlink.vehicle``), protocol (``mavlink.protocol``, one a link) and ports
are three things; the first two run in simulated time without a socket. It shares no code with the driver.
"""

from __future__ import annotations

import math
import socket
import threading
from collections import deque
from pathlib import Path

from camrig.clock import Clock, RealClock
from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.interfaces import Plugin
from camrig_emulators.delayed import Address
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.messages_more import MESSAGES
from camrig_emulators.mavlink.protocol import KEPT_RECEIVED, MavlinkProtocol, Received
from camrig_emulators.mavlink.serial_link import SERIAL, SerialLink
from camrig_emulators.mavlink.settings import MavlinkDroneSettings
from camrig_emulators.mavlink.tcp_port import TcpPort
from camrig_emulators.mavlink.troubles import Troubles
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.pty_line import PtyLine
from camrig_emulators.udp_port import UdpPort

__all__ = ["MavlinkDrone", "MavlinkDroneSettings", "Received", "emulator"]

_CLOCK_SLACK_S = 0.02


class MavlinkDrone:
    """An ``Emulator``; also gives the truth and what it has heard. Everything may be called from any thread."""

    def __init__(self, settings: MavlinkDroneSettings, *, clock: Clock | None = None, seed: int | None = None) -> None:
        """Build it; ``settings.script`` counts from its start. ``seed`` replaces that of the settings.

        Raises InputError for a wrong script, and for streams of messages that it does not know.
        """
        self.settings = settings
        self.faults = Faults()
        self._clock = RealClock() if clock is None else clock
        self._seed = settings.seed if seed is None else seed
        self._lock = threading.Lock()
        self._port: UdpPort | TcpPort | None = None
        self._lines: list[PtyLine] = []
        self._url: str | None = None
        self._power_up(None)

    def start(self) -> str:
        """Power up and serve; returns the driver's url. Raises InputError for a target or port that cannot be."""
        if self._url is not None:
            return self._url
        settings = self.settings
        target = None if settings.target is None else _address(settings.target)
        self._power_up(SERIAL if settings.transport == "serial" else target)
        name = f"emulated {settings.id}"
        parts = (self._lock, self._clock, self.faults, self._seed, settings.port)
        match settings.transport:
            case "udp":
                self._port = UdpPort(name, self._protocol, *parts)
                self._url = f"udpout://127.0.0.1:{self._port.port}" if target is None else f"udp://{settings.target}"
            case "tcp":
                self._port = TcpPort(name, self._protocol, *parts)
                self._url = f"tcp://127.0.0.1:{self._port.port}"
            case "serial":
                self._url = f"serial://{self._open_line(settings.id, self._protocol)}:{settings.baud}"
        if settings.usb is not None:
            self._plug_usb(Path(settings.usb))
        return self._url

    def describe(self) -> str:
        with self._lock:
            vehicle, now_s = self._vehicle, self._clock.now_s()
            vehicle.advance_to(now_s)
            truth, cockpit = vehicle.history.latest.truth, vehicle.cockpit
            peers = sum(link.listeners(now_s) for link in self._links)
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
        for line in self._lines:
            line.stop()
        if self._lines and self.settings.usb is not None:
            Path(self.settings.usb).unlink(missing_ok=True)
        self._lines = []
        self._url = None

    def happen(self, fault: str) -> None:
        """Let one thing happen at once, in the words of ``mavlink.troubles``: ``no_pose``, ``wind 2``, ``clear``.

        Raises InputError for what it does not know.
        """
        with self._lock:
            now_s = self._clock.now_s()
            self._vehicle.advance_to(now_s)
            self._troubles.now(fault, now_s)

    def T_world_body(self, stamp_s: float) -> Transform:
        """Return the true pose at a stamp of the last 20 s; the same stamp always gives the same pose.

        Raises ValueError for a stamp that is older, or in the future.
        """
        with self._lock:
            if stamp_s > self._clock.now_s() + _CLOCK_SLACK_S:
                raise ValueError(f"{stamp_s:.3f} s is in the future")
            return self._vehicle.T_world_body(stamp_s)

    @property
    def received(self) -> list[Received]:
        """What it has heard, oldest first (the newest 50 000)."""
        with self._lock:
            return list(self._received)

    def _power_up(self, target: Address | None) -> None:
        now_s = self._clock.now_s()
        self._vehicle = Vehicle(self.settings, now_s, self._seed)
        unknown = self.settings.streams_hz.keys() - MESSAGES[self._vehicle.firmware.autopilot].keys()
        if unknown:
            numbers = ", ".join(map(str, sorted(unknown)))
            raise InputError(f"streams_hz: {self.settings.flavour} is emulated without message {numbers}")
        self._received: deque[Received] = deque(maxlen=KEPT_RECEIVED)
        self._links: list[MavlinkProtocol] = []
        self._protocol = self._link(target, channel=1)
        self._troubles = Troubles(self._vehicle, self.faults, self._links, self._seed)
        self._troubles.schedule(self.settings.script, now_s)

    def _link(self, target: Address | None, channel: int) -> MavlinkProtocol:
        link = MavlinkProtocol(self._vehicle, self.faults, self._seed, target, channel=channel, received=self._received)
        self._links.append(link)
        return link

    def _plug_usb(self, path: Path) -> None:
        try:
            path.symlink_to(self._open_line(f"{self.settings.id}-usb", self._link(SERIAL, channel=0)))
        except OSError as error:
            self._lines.pop().stop()
            self.stop()
            raise InputError(f"usb {path}: {error.strerror}; give a path that can be made") from error

    def _open_line(self, name: str, protocol: MavlinkProtocol) -> str:
        device = SerialLink(protocol, self._lock, self.faults, self.settings.baud, self._seed)
        line = PtyLine(name, device, clock=self._clock, faults=self.faults)
        line.start()
        self._lines.append(line)
        return line.path


def _address(target: str) -> Address:
    host, port = target.rsplit(":", 1)
    try:
        return socket.gethostbyname(host), int(port)
    except OSError as error:
        raise InputError(f"target {target}: {host} is no host; give host:port, for example 127.0.0.1:14540") from error


emulator: Plugin[MavlinkDrone] = Plugin(section=MavlinkDroneSettings, make=MavlinkDrone)
