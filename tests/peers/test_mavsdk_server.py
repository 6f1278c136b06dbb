"""Our driver against MAVSDK's server side (ActionServer, TelemetryServer, ParamServer): refused as it is, then flown.

MAVSDK 4.1 cannot be told which autopilot it is: its heartbeat says type 0 of autopilot 0, and its AUTOPILOT_VERSION
does not claim local position targets. Both are refused by name. To be flown it is introduced as a PX4 quadrotor, whose
mode numbers it has, by a relay that changes these three numbers and nothing else; all other bytes are MAVSDK's.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.clock import RealClock
from camrig.errors import HardwareError
from camrig.messages import DroneHealth
from camrig.rig import DroneSpec
from camrig_drivers.mavlink import MavlinkDrone, MavlinkSection
from camrig_drivers.mavlink.link import Link
from tests.mavlink_peer import free_port
from tests.peers.grounds import need_mavsdk

pytestmark = pytest.mark.peers
SERVER = Path(__file__).with_name("mavsdk_server.py")
SPEC = DroneSpec("d1", ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=0.8)
LOCAL_TARGETS = 128
"""MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED."""


class Introduction:
    """Relays between a server and a driver; what it is told to say of the vehicle replaces what MAVSDK says."""

    def __init__(self, driver_port: int, *, heartbeat: bool = True, capability: bool = True) -> None:
        self._heartbeat, self._capability = heartbeat, capability
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind(("127.0.0.1", 0))
        self._back.connect(("127.0.0.1", driver_port))
        for end in (self._front, self._back):
            end.settimeout(0.1)
        self.port = int(self._front.getsockname()[1])
        self._server: tuple[str, int] | None = None
        self._ending = threading.Event()
        self._threads = [threading.Thread(target=work) for work in (self._to_driver, self._to_server)]

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        for thread in self._threads:
            thread.start()
        try:
            yield
        finally:
            self._ending.set()
            for thread in self._threads:
                thread.join()
            self._front.close()
            self._back.close()

    def _to_driver(self) -> None:
        parser = dialect.MAVLink(None)
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError, ConnectionRefusedError):
                data, self._server = self._front.recvfrom(4096)
                for message in parser.parse_buffer(bytearray(data)) or []:
                    self._back.send(self._introduced(message))

    def _introduced(self, message: Any) -> bytes:
        kind = message.get_type()
        if kind == "HEARTBEAT" and self._heartbeat:
            message.autopilot, message.type = dialect.MAV_AUTOPILOT_PX4, dialect.MAV_TYPE_QUADROTOR
        elif kind == "AUTOPILOT_VERSION" and self._capability:
            message.capabilities |= LOCAL_TARGETS
        else:
            return bytes(message.get_msgbuf())
        packer = dialect.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
        packer.seq = message.get_seq()
        return bytes(message.pack(packer))

    def _to_server(self) -> None:
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError, ConnectionRefusedError):
                data = self._back.recv(4096)
                if self._server is not None:
                    self._front.sendto(data, self._server)


@contextlib.contextmanager
def served(**introduced: bool) -> Iterator[tuple[MavlinkDrone, list[dict[str, Any]]]]:
    """Start a server and return a driver that listens for it, and the orders that it takes."""
    need_mavsdk()
    port = free_port()
    section = MavlinkSection(url=f"udp://127.0.0.1:{port}")
    drone = MavlinkDrone(SPEC, section, Link(section.url, RealClock()))
    relay = Introduction(port, **introduced)
    orders: list[dict[str, Any]] = []
    with relay.running():
        command = [sys.executable, str(SERVER), f"udpout://127.0.0.1:{relay.port}"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:

            def listen() -> None:
                assert server.stdout is not None
                orders.extend(json.loads(line) for line in server.stdout if line.startswith("{"))

            listener = threading.Thread(target=listen)
            listener.start()
            try:
                yield drone, orders
            finally:
                drone.close()
                assert server.stdin is not None
                server.stdin.close()
                server.wait(10.0)
                listener.join()


def reads(drone: MavlinkDrone, holds: Callable[[DroneHealth], bool], limit_s: float = 20.0) -> DroneHealth:
    """Read until something holds of the drone's health."""
    end_s = time.monotonic() + limit_s
    while True:
        drone.read(0.05)
        health = drone.health()
        assert health is not None
        if holds(health):
            return health
        assert time.monotonic() < end_s, health


def test_what_does_not_say_which_autopilot_it_is_is_refused_by_name() -> None:
    reason = r"system 1 is autopilot type 0; ArduPilot \(3\) and PX4 \(12\)"
    with served(heartbeat=False, capability=False) as (drone, orders), pytest.raises(HardwareError, match=reason):
        drone.open()
    assert orders == []


def test_what_does_not_claim_to_take_set_points_is_not_armed() -> None:
    with served(capability=False) as (drone, orders):
        drone.open()
        reads(drone, lambda health: any("local position targets" in reason for reason in health.unfit))
        with pytest.raises(HardwareError, match=r"PX4 0\.0\.0 does not take local position targets"):
            drone.arm()
    assert orders == []


def test_it_is_flown() -> None:
    """Mode, arming, set-points, a move and a landing, judged by MAVSDK's own telemetry."""
    with served() as (drone, orders):
        drone.open()
        reads(drone, lambda health: not health.unfit)
        drone.arm()
        reads(drone, lambda health: health.obeys)
        drone.go_to((3.0, 1.5, 2.0), 0.0)
        end_s, place_m = time.monotonic() + 10.0, (0.0, 0.0, 0.0)
        while max(abs(a - b) for a, b in zip(place_m, (3.0, 1.5, 2.0), strict=True)) > 0.05:
            for reading in drone.read(0.05):
                place_m = tuple(reading.T_world_body[:3, 3].tolist())
            assert time.monotonic() < end_s, place_m
        drone.land()
        health = reads(drone, lambda health: health.activity == "passive")
        assert health.reason == ""
    assert [order["order"] for order in orders] == ["mode", "arm", "land", "landed"]
    assert orders[0]["mode"] == "OFFBOARD"
    assert orders[1] == {"order": "arm", "arm": True, "force": False}
    assert orders[3]["place_ned_m"] == pytest.approx([1.5, 3.0, 0.0], abs=0.05)
    assert orders[3]["set_points"] > 60
