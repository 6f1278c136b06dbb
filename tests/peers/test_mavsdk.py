"""MAVSDK, which knows nothing of us, flies the emulated drone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.peers.grounds import FLAVOURS, HOLD_NOISE_M, TARGET_NED_M, Flavour, drone, need_mavsdk

pytestmark = pytest.mark.peers
PILOT = Path(__file__).with_name("mavsdk_pilot.py")
Flights = dict[tuple[Flavour, str], tuple[int, str, list[dict[str, Any]], list[str]]]
ROUTES: tuple[tuple[Flavour, str], ...] = (("ardupilot", "udp"), ("px4", "udp"), ("ardupilot", "tcp"))


@pytest.fixture(scope="module")
def flights() -> Iterator[Flights]:
    """Fly all routes at the same time: exit code, what was said wrong, steps, what the drone heard."""
    need_mavsdk()
    with ExitStack() as stack:
        started = {}
        for flavour, transport in ROUTES:
            url, emulated = stack.enter_context(drone(flavour, transport=transport))
            pilot = subprocess.Popen(
                [sys.executable, str(PILOT), url.replace("tcp://", "tcpout://")],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            started[flavour, transport] = pilot, emulated
            stack.callback(pilot.kill)
        done: Flights = {}
        for route, (pilot, emulated) in started.items():
            out, wrong = pilot.communicate(timeout=90.0)
            steps = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
            done[route] = pilot.returncode, wrong, steps, [entry.name for entry in emulated.received]
        yield done


@pytest.mark.parametrize("route", ROUTES, ids="-".join)
def test_it_flies_the_whole_flight(flights: Flights, route: tuple[Flavour, str]) -> None:
    code, wrong, steps, _ = flights[route]
    assert code == 0, wrong
    names = ["connected", "healthy", "parameters", "armed", "up", "there", "landed"]
    assert [step["step"] for step in steps] == names
    by_name = {step["step"]: step for step in steps}
    assert by_name["there"]["place_ned_m"] == pytest.approx(TARGET_NED_M, abs=HOLD_NOISE_M)
    assert by_name["there"]["flight_mode"] == "OFFBOARD"
    assert by_name["landed"]["place_ned_m"] == pytest.approx((1.0, 2.0, 0.0), abs=HOLD_NOISE_M)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_streams_set_points_and_reads_parameters(flights: Flights, flavour: Flavour) -> None:
    _, _, steps, heard = flights[flavour, "udp"]
    assert heard.count("SET_POSITION_TARGET_LOCAL_NED") > 20
    named = next(step["names"] for step in steps if step["step"] == "parameters")
    assert {"ardupilot": "FS_GCS_ENABLE", "px4": "COM_OBL_RC_ACT"}[flavour] in named
