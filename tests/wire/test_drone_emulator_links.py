"""The emulated drone on TCP, on a serial line, and on two links at once."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import pytest
import serial
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.errors import InputError
from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings
from tests.drone_pilot import ARM, REQUEST, SET_INTERVAL, command_long

REBOOT = 246


class Pipe(Protocol):
    """Bytes both ways; reading waits a moment and returns nothing then."""

    def write(self, data: bytes) -> object: ...

    def read(self) -> bytes: ...


class Tcp:
    def __init__(self, url: str) -> None:
        host, port = url.removeprefix("tcp://").split(":")
        self.socket = socket.create_connection((host, int(port)), timeout=5.0)
        self.socket.settimeout(0.02)
        self.ended = False

    def write(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self) -> bytes:
        with contextlib.suppress(TimeoutError):
            data = self.socket.recv(4096)
            self.ended = self.ended or not data
            return data
        return b""

    def close(self) -> None:
        self.socket.close()


class Line:
    def __init__(self, path: str, baud: int) -> None:
        self.port = serial.Serial(path, baud, timeout=0.02)

    def write(self, data: bytes) -> None:
        self.port.write(data)

    def read(self) -> bytes:
        return self.port.read(4096)

    def close(self) -> None:
        self.port.close()


class Station:
    """A ground station on any pipe."""

    def __init__(self, pipe: Pipe) -> None:
        self.pipe = pipe
        self.heard: list[Any] = []
        self.mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True

    def names(self) -> list[str]:
        return [message.get_type() for message in self.heard]

    def say(self, message: Any) -> None:
        self.pipe.write(bytes(message.pack(self.mav)))

    def listen(self) -> None:
        self.heard += self.mav.parse_buffer(self.pipe.read()) or []

    def until(self, holds: Callable[[], bool], limit_s: float = 10.0) -> None:
        end_s = time.monotonic() + limit_s
        while not holds():
            assert time.monotonic() < end_s, self.names()
            self.listen()

    def command(self, number: int, *params: float) -> int:
        self.heard.clear()
        self.say(command_long(number, *params))
        self.until(lambda: "COMMAND_ACK" in self.names())
        return int(next(message.result for message in self.heard if message.get_type() == "COMMAND_ACK"))


@contextmanager
def running(**settings: Any) -> Iterator[tuple[MavlinkDrone, str]]:
    drone = MavlinkDrone(MavlinkDroneSettings.model_validate(settings))
    try:
        yield drone, drone.start()
    finally:
        drone.stop()


@contextmanager
def on_tcp(url: str) -> Iterator[tuple[Tcp, Station]]:
    pipe = Tcp(url)
    with contextlib.closing(pipe):
        yield pipe, Station(pipe)


@contextmanager
def on_line(path: str, baud: int = 115200) -> Iterator[Station]:
    line = Line(path, baud)
    with contextlib.closing(line):
        yield Station(line)


def test_tcp_speaks_at_once_and_ends_with_a_reboot() -> None:
    with running(transport="tcp") as (drone, url):
        with on_tcp(url) as (pipe, station):
            station.until(lambda: "HEARTBEAT" in station.names())
            assert station.command(SET_INTERVAL, 32, 5e4) == 0
            station.until(lambda: "LOCAL_POSITION_NED" in station.names())
            assert station.command(REBOOT, 1) == 0  # acknowledged, and then
            station.until(lambda: pipe.ended)
        with on_tcp(url) as (_, station):
            station.until(lambda: station.names().count("HEARTBEAT") >= 2)
            assert "LOCAL_POSITION_NED" not in station.names()
        assert drone.describe().startswith("drone: ardupilot STABILIZE, disarmed")


def test_each_tcp_connection_is_a_link_of_its_own() -> None:
    with running(transport="tcp") as (_, url), on_tcp(url) as (_, first), on_tcp(url) as (_, second):
        assert first.command(SET_INTERVAL, 32, 2e4) == 0
        second.until(lambda: "HEARTBEAT" in second.names())
        first.until(lambda: first.names().count("LOCAL_POSITION_NED") > 5)
        second.listen()
        assert "LOCAL_POSITION_NED" not in second.names()


def test_unplugged_tcp_refuses_and_comes_back() -> None:
    with running(transport="tcp") as (drone, url):
        with on_tcp(url) as (pipe, station):
            station.until(lambda: "HEARTBEAT" in station.names())
            drone.faults.unplug()
            station.until(lambda: pipe.ended)
        with pytest.raises(OSError, match="refused"):
            Tcp(url)
        drone.faults.replug()
        time.sleep(0.3)
        with on_tcp(url) as (_, station):
            assert station.command(REQUEST, 148) == 0


def test_a_port_that_is_taken_is_named() -> None:
    with running(transport="tcp") as (_, url):
        port = int(url.rpartition(":")[2])
        with pytest.raises(InputError, match=f"TCP port {port} of 127.0.0.1: .*give another one, or 0"):
            MavlinkDrone(MavlinkDroneSettings(transport="tcp", port=port)).start()
    with running() as (_, url):
        port = int(url.rpartition(":")[2])
        with pytest.raises(InputError, match=f"UDP port {port} of 127.0.0.1"):
            MavlinkDrone(MavlinkDroneSettings(port=port)).start()


def test_a_serial_line_is_as_fast_as_its_baud_rate_and_telemetry_thins_out() -> None:
    with running(transport="serial", flavour="px4", baud=57600) as (_, url):
        path, _, baud = url.removeprefix("serial://").rpartition(":")
        with on_line(path, int(baud)) as station:
            station.until(lambda: "LOCAL_POSITION_NED" in station.names())
            station.heard.clear()
            start_s = time.monotonic()
            station.until(lambda: time.monotonic() - start_s > 1.5)
            lasted_s = time.monotonic() - start_s
            rate = sum(len(message.get_msgbuf()) for message in station.heard) / lasted_s
            assert 1000 < rate < 1.3 * 5760  # all it pushes would be 20 000 bytes a second
            assert "BAD_DATA" not in station.names()[2:]
            assert station.command(ARM, 1) == 0


def test_a_wrong_baud_rate_is_noise() -> None:
    with running(transport="serial") as (_, url):
        path = url.removeprefix("serial://").rpartition(":")[0]
        with on_line(path, 57600) as station:
            station.until(lambda: "BAD_DATA" in station.names())
            assert "HEARTBEAT" not in station.names()


def test_usb_is_channel_0_of_the_same_vehicle(tmp_path: Path) -> None:
    path = str(tmp_path / "usb")
    with running(transport="tcp", usb=path) as (_, url), on_tcp(url) as (_, radio), on_line(path) as usb:
        usb.say(dialect.MAVLink_setup_signing_message(1, 1, list(range(32)), 1))
        assert usb.command(ARM, 1) == 0  # still unsigned
        radio.say(command_long(ARM, 0))
        radio.until(lambda: any(m.get_header().incompat_flags & 1 for m in radio.heard if m.get_type() != "BAD_DATA"))
        assert "COMMAND_ACK" not in radio.names()
    assert not os.path.lexists(path)


def test_two_drones_of_one_system_may_speak_to_one_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5.0)
        target = f"127.0.0.1:{opened.getsockname()[1]}"
        with running(target=target), running(target=target, flavour="px4"):
            autopilots: set[int] = set()
            parser = dialect.MAVLink(None)
            parser.robust_parsing = True
            while autopilots != {3, 12}:
                for message in parser.parse_buffer(opened.recv(2048)) or ():
                    if message.get_type() == "HEARTBEAT":
                        assert message.get_srcSystem() == 1
                        autopilots.add(message.autopilot)


def test_a_path_for_usb_must_be_free(tmp_path: Path) -> None:
    taken = tmp_path / "usb"
    taken.touch()
    with pytest.raises(InputError, match=r"usb .*: File exists; give a path that can be made"):
        MavlinkDrone(MavlinkDroneSettings(usb=str(taken))).start()
    assert taken.exists()
