"""MAVProxy, which knows nothing of us, flies the emulated drone by its command line."""

from __future__ import annotations

import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from camrig_emulators.mavlink_drone import MavlinkDrone
from tests.peers.grounds import FLAVOURS, HOLD_NOISE_M, Flavour, drone, mavproxy

pytestmark = pytest.mark.peers
SET_POINT = "message SET_POSITION_TARGET_LOCAL_NED 0 1 1 1 3576 1 2 -2 0 0 0 0 0 0 0 0"
ARDUPILOT_PARAMETER, PX4_PARAMETER = "FS_GCS_ENABLE", "COM_OBL_RC_ACT"


class Console:
    """A running MAVProxy: what is typed, and what it has printed since."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self.printed = ""
        self._mark = 0
        self._reader = threading.Thread(target=self._read, name="mavproxy's console")
        self._reader.start()

    def type(self, line: str) -> None:
        assert self._process.stdin is not None
        self._mark = len(self.printed)
        self._process.stdin.write(f"{line}\n".encode())
        self._process.stdin.flush()

    def until(self, pattern: str, again: str | None = None, limit_s: float = 30.0) -> re.Match[str]:
        """Wait for what it prints to the line typed last, typing ``again`` five times a second."""
        end_s, mark = time.monotonic() + limit_s, self._mark
        while (match := re.search(pattern, self.printed[mark:])) is None:
            assert time.monotonic() < end_s, f"no {pattern!r} in {self.printed[mark:]}"
            if again is not None:
                self.type(again)
            time.sleep(0.2)
        return match

    def place_ned_m(self) -> tuple[float, ...]:
        self.type("status LOCAL_POSITION_NED")
        match = self.until(r"LOCAL_POSITION_NED \{.*?\bx : (\S+), y : (\S+), z : (\S+),")
        return tuple(float(number) for number in match.groups())

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout is not None
        while data := os.read(self._process.stdout.fileno(), 4096):
            self.printed += data.decode(errors="replace")


@contextmanager
def console(url: str, folder: Path) -> Iterator[Console]:
    command = [mavproxy(), f"--master={url.replace('://', ':')}", f"--state-basedir={folder}", "--aircraft=it"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(folder)}
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=environment,
        cwd=folder,
    ) as process:
        running = Console(process)
        try:
            yield running
        finally:
            running.end()


def true_place(emulated: MavlinkDrone) -> tuple[float, float, float]:
    x, y, z = emulated.T_world_body(time.monotonic() - 0.05)[:3, 3]
    return float(y), float(x), float(-z)


def wait_until_near(console: Console, place_ned_m: tuple[float, float, float], again: str | None = None) -> None:
    end_s = time.monotonic() + 20.0
    while max(abs(a - b) for a, b in zip(console.place_ned_m(), place_ned_m, strict=True)) > HOLD_NOISE_M:
        assert time.monotonic() < end_s, f"at {console.place_ned_m()}"
        if again is not None:
            console.type(again)
        time.sleep(0.1)


def fly_ardupilot(console: Console, emulated: MavlinkDrone) -> None:
    console.until("online system 1")
    console.until(r"Received \d+ parameters")
    console.type(f"param show {ARDUPILOT_PARAMETER}")
    console.until(rf"{ARDUPILOT_PARAMETER}\s+0")
    console.type("mode GUIDED")
    console.until("Mode GUIDED")
    console.type("arm throttle")
    console.until("ARMED")
    console.type("takeoff 2")
    console.until("NAV_TAKEOFF: ACCEPTED")
    wait_until_near(console, (0.0, 0.0, -2.0))
    console.type("position 2 -1 0")  # forward 2 m, 1 m to the left, and the nose is to the east
    wait_until_near(console, (1.0, 2.0, -2.0))
    assert true_place(emulated) == pytest.approx((1.0, 2.0, -2.0), abs=HOLD_NOISE_M)
    console.type("mode LAND")
    console.until("DISARMED")
    assert true_place(emulated) == pytest.approx((1.0, 2.0, 0.0), abs=HOLD_NOISE_M)
    assert "fence breach" not in console.printed


def fly_px4(console: Console, emulated: MavlinkDrone) -> None:
    """Its ``mode`` fails on PX4's modes and its ``position`` is in a frame that PX4 ignores: messages by name do it."""
    console.until("online system 1")
    console.until(r"Received \d+ parameters")
    console.type(f"param show {PX4_PARAMETER}")
    console.until(rf"{PX4_PARAMETER}\s+0")
    console.type("module load message")
    console.until("Loaded module message")
    console.type("arm throttle")
    console.until("ARMED")
    console.type("takeoff 2")
    console.until("Mode TAKEOFF")
    console.until("Mode LOITER")  # MIS_TAKEOFF_ALT above the floor: 2 m above the sea would be far below
    wait_until_near(console, (0.0, 0.0, -2.5))
    console.type(SET_POINT)
    console.type("long DO_SET_MODE 1 6")
    console.until("Mode OFFBOARD", again=SET_POINT)
    wait_until_near(console, (1.0, 2.0, -2.0), again=SET_POINT)
    assert true_place(emulated) == pytest.approx((1.0, 2.0, -2.0), abs=HOLD_NOISE_M)
    console.type("long NAV_LAND")
    console.until("DISARMED")
    assert true_place(emulated) == pytest.approx((1.0, 2.0, 0.0), abs=HOLD_NOISE_M)


FLIGHTS: dict[Flavour, Callable[[Console, MavlinkDrone], None]] = {"ardupilot": fly_ardupilot, "px4": fly_px4}


def flight(flavour: Flavour, folder: Path) -> None:
    with drone(flavour) as (url, emulated), console(url, folder) as running:
        FLIGHTS[flavour](running, emulated)


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[Flavour, Future[None]]]:
    """Fly both at the same time."""
    mavproxy()  # or skip
    with ThreadPoolExecutor(thread_name_prefix="flight") as pool:
        yield {name: pool.submit(flight, name, tmp_path_factory.mktemp(f"mavproxy-{name}")) for name in FLAVOURS}


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_flies_the_whole_flight(flights: dict[Flavour, Future[None]], flavour: Flavour) -> None:
    """Connect, parameters, mode, arm, take-off, position, land: what fails, fails here with what it had printed."""
    flights[flavour].result(timeout=120.0)
