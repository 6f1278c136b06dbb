"""The emulated drone over real UDP, flown by a hand-written ground station through the documented recipes."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.errors import InputError
from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings, emulator
from tests.drone_pilot import ARM, GUIDED, LAND, SET_INTERVAL, SET_MODE, TAKE_OFF, command_long, set_point

BRISK: dict[str, Any] = {
    "acceleration_m_s2": 4.0,
    "climb_speed_m_s": 2.0,
    "land_speed_m_s": 1.0,
    "land_disarm_s": 0.2,
}


class GroundStation:
    """A blocking UDP client with a heartbeat and the newest message of each kind."""

    def __init__(self, opened: socket.socket, address: tuple[str, int] | None) -> None:
        self._socket = opened
        self._socket.settimeout(0.02)
        self.address = address
        self.last: dict[str, Any] = {}
        self.count = 0
        self._packer = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._beat_s = self._point_s = 0.0

    def say(self, message: Any) -> None:
        assert self.address is not None
        self._socket.sendto(bytes(message.pack(self._packer)), self.address)

    def until(self, holds: Callable[[], bool], point: Any = None, limit_s: float = 10.0) -> float:
        start_s = time.monotonic()
        while not holds():
            now_s = time.monotonic()
            assert now_s - start_s < limit_s, f"it never came true; last: {self.last}"
            self._speak(now_s, point)
            self.hear()
        return time.monotonic() - start_s

    def command(self, number: int, *params: float) -> int:
        self.last.pop("COMMAND_ACK", None)
        self.say(command_long(number, *params))
        self.until(lambda: "COMMAND_ACK" in self.last and self.last["COMMAND_ACK"].command == number)
        return int(self.last["COMMAND_ACK"].result)

    def near(self, north: float, east: float, down: float) -> bool:
        place = self.last.get("LOCAL_POSITION_NED")
        return place is not None and bool(np.hypot(place.x - north, place.y - east) + abs(place.z - down) < 0.1)

    @property
    def armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & 128)

    def _speak(self, now_s: float, point: Any) -> None:
        if self.address is not None and now_s - self._beat_s > 1.0:
            self._beat_s = now_s
            self.say(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
        if point is not None and now_s - self._point_s > 0.05:
            self._point_s = now_s
            self.say(point)

    def hear(self) -> None:
        try:
            data, self.address = self._socket.recvfrom(2048)
        except OSError:
            return
        for message in self._parser.parse_buffer(data) or ():
            self.last[message.get_type()] = message
            self.count += 1


@contextmanager
def bound() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        yield opened


@contextmanager
def running(**settings: Any) -> Iterator[tuple[MavlinkDrone, GroundStation]]:
    drone = MavlinkDrone(MavlinkDroneSettings.model_validate({**BRISK, **settings}), seed=1)
    try:
        scheme, _, port = drone.start().rpartition(":")
        assert scheme == "udpout://127.0.0.1"
        with bound() as opened:
            yield drone, GroundStation(opened, ("127.0.0.1", int(port)))
    finally:
        drone.stop()


def assert_true_place(drone: MavlinkDrone, expected_m: tuple[float, float, float]) -> None:
    assert drone.T_world_body(time.monotonic() - 0.05)[:3, 3] == pytest.approx(np.array(expected_m), abs=0.12)


def land(station: GroundStation) -> None:
    assert station.command(LAND) == 0
    station.until(lambda: not station.armed and station.last["EXTENDED_SYS_STATE"].landed_state == 1)


def test_ardupilot_flies_its_recipe() -> None:
    with running(flavour="ardupilot") as (drone, station):
        station.until(lambda: "HEARTBEAT" in station.last)
        for number, rate_hz in ((32, 30.0), (30, 30.0), (245, 4.0)):
            assert station.command(SET_INTERVAL, number, 1e6 / rate_hz) == 0
        assert station.command(SET_MODE, 1, GUIDED) == 0
        station.until(lambda: station.last["HEARTBEAT"].custom_mode == GUIDED)
        assert station.command(ARM, 1) == 0
        assert station.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, 1.0) == 0
        station.until(lambda: station.near(0.0, 0.0, -1.0))
        station.until(lambda: station.near(0.5, 1.0, -1.0), set_point((0.5, 1.0, -1.0)))
        assert_true_place(drone, (1.0, 0.5, 1.0))
        land(station)
        assert [entry.fields["command"] for entry in drone.received if entry.name == "COMMAND_LONG"] == [
            SET_INTERVAL,
            SET_INTERVAL,
            SET_INTERVAL,
            SET_MODE,
            ARM,
            TAKE_OFF,
            LAND,
        ]


def test_px4_flies_its_recipe() -> None:
    with running(flavour="px4") as (drone, station):
        up, there = set_point((0.0, 0.0, -1.0)), set_point((0.5, 1.0, -1.0))
        station.until(lambda: "LOCAL_POSITION_NED" in station.last, up)
        assert station.command(SET_MODE, 1, 6) == 0
        station.until(lambda: station.last["HEARTBEAT"].custom_mode == 6 << 16, up)
        assert station.command(ARM, 1) == 0
        station.until(lambda: station.near(0.0, 0.0, -1.0), up)
        station.until(lambda: station.near(0.5, 1.0, -1.0), there)
        assert_true_place(drone, (1.0, 0.5, 1.0))
        land(station)


def test_it_speaks_first_to_a_target() -> None:
    with bound() as opened:
        target = f"127.0.0.1:{opened.getsockname()[1]}"
        drone = MavlinkDrone(MavlinkDroneSettings(target=target, flavour="px4"))
        try:
            assert drone.start() == f"udp://{target}"
            station = GroundStation(opened, None)
            station.until(lambda: "HEARTBEAT" in station.last)
            assert station.command(ARM, 1) == 0
        finally:
            drone.stop()


def test_a_target_must_be_a_host() -> None:
    with pytest.raises(InputError, match=r"no\.such\.host\.invalid"):
        MavlinkDrone(MavlinkDroneSettings(target="no.such.host.invalid:14550")).start()


def test_faults_of_the_link() -> None:
    with running(flavour="px4") as (drone, station):
        station.until(lambda: station.count > 50)
        drone.faults.silent = True
        station.until(lambda: silent_for(station, 0.3))
        drone.faults.clear()
        station.until(lambda: "LOCAL_POSITION_NED" in station.last)
        drone.faults.latency_s = 0.3
        asked_s = time.monotonic()
        assert station.command(ARM, 1) == 0
        assert time.monotonic() - asked_s >= 0.3
        drone.faults.clear()
        drone.faults.unplug()
        station.until(lambda: silent_for(station, 0.3))
        drone.faults.replug()
        station.last.clear()
        station.until(lambda: "HEARTBEAT" in station.last)
        assert station.armed  # the link was away, the drone was not


def silent_for(station: GroundStation, duration_s: float) -> bool:
    count, start_s = station.count, time.monotonic()
    while time.monotonic() - start_s < duration_s:
        station.hear()
    return station.count == count


def test_as_camrig_emulate_runs_it() -> None:
    drone = emulator.make(emulator.section(id="d1"))
    url = drone.start()
    assert drone.start() == url
    assert drone.describe().startswith("d1: ardupilot STABILIZE, disarmed")
    drone.stop()
    drone.stop()
    assert drone.start().startswith("udpout://127.0.0.1:")
    drone.stop()
