"""A peer on UDP that says exactly what a test tells it to, and drones that fly with it."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.clock import RealClock
from camrig.rig import DroneSpec
from camrig_drivers.mavlink import MavlinkDrone, MavlinkSection
from camrig_drivers.mavlink.link import Link

SPEC = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=0.5)
ARDUPILOT, PX4, NOT_AN_AUTOPILOT = 3, 12, 8
GUIDED = 4


class LeapClock(RealClock):
    """The real clock, which a test can put forward."""

    ahead_s = 0.0

    def now_s(self) -> float:
        return super().now_s() + self.ahead_s


class Peer:
    """One socket that speaks as a vehicle."""

    def __init__(self, opened: socket.socket, system: int = 1, component: int = 1) -> None:
        self.socket = opened
        self.driver_address: tuple[str, int] | None = None
        self._mavlink = dialect.MAVLink(None, system, component)
        self._mavlink.robust_parsing = True

    def say(self, *messages: Any) -> None:
        """Send all messages in one datagram."""
        data = b"".join(bytes(message.pack(self._mavlink)) for message in messages)
        if self.driver_address is None:
            self.socket.send(data)
        else:
            self.socket.sendto(data, self.driver_address)

    def parse(self, data: bytes) -> list[Any]:
        """Return the messages of one datagram."""
        return self._mavlink.parse_buffer(bytearray(data)) or []

    def heard(self, timeout_s: float = 0.2) -> list[Any]:
        """Return the messages that arrive until ``timeout_s`` of silence."""
        messages: list[Any] = []
        self.socket.settimeout(timeout_s)
        with contextlib.suppress(TimeoutError):
            while True:
                data, self.driver_address = self.socket.recvfrom(2048)
                messages += self.parse(data)
        return messages


@contextlib.contextmanager
def listening() -> Iterator[Peer]:
    """Open a peer to which the driver sends first."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        yield Peer(opened)


@contextlib.contextmanager
def sending(port: int, system: int = 1, component: int = 1) -> Iterator[Peer]:
    """Open a peer that sends to the driver's port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.connect(("127.0.0.1", port))
        yield Peer(opened, system, component)


def url_of(peer: Peer) -> str:
    return f"udpout://127.0.0.1:{peer.socket.getsockname()[1]}"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def heartbeat(autopilot: int = ARDUPILOT, mode: int = 0, *, armed: bool = False, kind: int = 2) -> Any:
    return dialect.MAVLink_heartbeat_message(kind, autopilot, 1 | 128 * armed, mode, 4, 3)


def telemetry(boot_ms: int, *, landed_state: int = 1, height_m: float = 0.0) -> tuple[Any, ...]:
    return (
        dialect.MAVLink_sys_status_message(0, 0, 0, 0, 16000, 500, 90, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_extended_sys_state_message(0, landed_state),
        dialect.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        dialect.MAVLink_local_position_ned_message(boot_ms, 2.0, 1.0, -height_m, 0.0, 0.0, 0.0),
    )


def parameters() -> list[Any]:
    """Return what ArduCopter must have, as it tells it."""
    table = {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 5.0, "GUID_TIMEOUT": 1.0, "MAV_GCS_SYSID": 255.0}
    return [
        dialect.MAVLink_param_value_message(name.encode(), value, 9, len(table), index)
        for index, (name, value) in enumerate(table.items())
    ]


def px4_parameters() -> list[Any]:
    """Return what PX4 must have, as it tells it: an integer's bits in a float."""
    told = [("COM_OBL_RC_ACT", struct.unpack("<f", struct.pack("<i", 4))[0], 6)]
    told += [("NAV_DLL_ACT", struct.unpack("<f", struct.pack("<i", 3))[0], 6), ("COM_OF_LOSS_T", 1.0, 9)]
    return [dialect.MAVLink_param_value_message(name.encode(), value, kind, 3, 0) for name, value, kind in told]


def make_drone(url: str, clock: RealClock | None = None, **keys: Any) -> MavlinkDrone:
    used = clock or RealClock()
    return MavlinkDrone(SPEC, MavlinkSection(url=url, **keys), Link(url, used), used)


@contextlib.contextmanager
def opened(drone: MavlinkDrone, peer: Peer, *greeting: Any) -> Iterator[MavlinkDrone]:
    """Open a drone at a listening peer that greets it when it has heard it."""

    def greet() -> None:
        peer.heard(0.05)
        peer.say(*greeting or [heartbeat()])

    greeter = threading.Thread(target=greet)
    greeter.start()
    try:
        drone.open()
        yield drone
    finally:
        greeter.join()
        drone.close()


@contextlib.contextmanager
def found(drone: MavlinkDrone, peer: Peer, autopilot: int = ARDUPILOT) -> Iterator[MavlinkDrone]:
    """Open a listening drone while a peer sends heartbeats to its port."""
    opener = threading.Thread(target=drone.open)
    opener.start()
    try:
        while opener.is_alive():
            time.sleep(0.02)
            with contextlib.suppress(OSError):  # the driver's port may not be open yet
                peer.say(heartbeat(autopilot))
        yield drone
    finally:
        opener.join()
        drone.close()


def served(drone: MavlinkDrone, duration_s: float = 0.1) -> None:
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        drone.read(0.02)
