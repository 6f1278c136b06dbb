"""The daemon is killed while a drone flies: the autopilot's own failsafe takes over, and nobody else."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest

from camrig.runtime.operator_client import ask
from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings
from tests.runtime_parts import until

RIG = """\
rig: killed
space: {{floor_m: [[0, 0], [5, 3]]}}
lenses:
  lab: {{size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}}
cameras:
  - {{id: sky, lens: lab, source: {{driver: fake, fps: 5}}, mount: {{drone: d1}}}}
drones:
  - {{id: d1, driver: mavlink, url: "{url}", box_m: [[0, 0, 1.0], [5, 3, 2.0]]}}
targets:
  - {{id: robot1, tags: [{{id: 1, size_m: 0.2}}]}}
"""
FALLS = {
    "ardupilot": {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 2.0, "GUID_TIMEOUT": 1.0},
    "px4": {"COM_OBL_RC_ACT": 4.0, "COM_FAIL_ACT_T": 1.0, "NAV_DLL_ACT": 3.0},
}
STAYS = {
    "ardupilot": {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 60.0, "GUID_TIMEOUT": 1.0},
    "px4": {"COM_OBL_RC_ACT": 5.0, "NAV_DLL_ACT": 1.0},
}
ORDERS = {"COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_LOCAL_NED"}
LIMIT_S = 60.0


@dataclass
class Site:
    """An emulated drone, and daemons that fly it one after the other."""

    folder: Path
    drone: MavlinkDrone
    daemon: subprocess.Popen[bytes] | None = None

    @property
    def socket(self) -> Path:
        return self.folder / "killed.sock"

    def start(self) -> None:
        self.daemon = subprocess.Popen(
            [sys.executable, "-m", "camrig", "run", str(self.folder / "rig.yaml")],
            env={**os.environ, "RUNTIME_DIRECTORY": str(self.folder)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until(lambda: self.told().get("link") == "up", LIMIT_S)

    def kill(self) -> None:
        assert self.daemon is not None
        self.daemon.send_signal(signal.SIGKILL)
        self.daemon.wait()
        self.daemon = None

    def told(self) -> dict[str, Any]:
        """Return what the daemon says of the drone; nothing while it does not answer."""
        with contextlib.suppress(Exception):
            answer: Any = ask(self.socket, {"command": "status"})
            return dict(answer["drones"]["d1"])
        time.sleep(0.05)
        return {}

    def order(self, command: dict[str, object]) -> None:
        ask(self.socket, command)

    def take_off(self) -> None:
        until(lambda: bool(self.told().get("fit")), LIMIT_S)
        self.order({"command": "arm", "drone": "d1"})
        until(lambda: self.told().get("control") == "planner" and self.told().get("activity") == "flying", LIMIT_S)

    def orders(self) -> int:
        upkeep = {511, 512}
        said = [message for message in self.drone.received if message.name in ORDERS]
        return sum(message.fields.get("command") not in upkeep for message in said)

    def height_m(self) -> float:
        return float(self.drone.T_world_body(time.monotonic())[2, 3])


@contextlib.contextmanager
def site(folder: Path, flavour: Literal["ardupilot", "px4"], params: dict[str, float]) -> Iterator[Site]:
    settings = MavlinkDroneSettings(flavour=flavour, start_position_m=(2.0, 1.5, 0.0), params=params, land_disarm_s=0.2)
    made = Site(folder, MavlinkDrone(settings, seed=1))
    (folder / "rig.yaml").write_text(RIG.format(url=made.drone.start()))
    try:
        yield made
    finally:
        if made.daemon is not None:
            made.kill()
        made.drone.stop()


@pytest.mark.parametrize("flavour", ["ardupilot", pytest.param("px4", marks=pytest.mark.slow)])
def test_a_drone_whose_daemon_is_killed_is_landed_by_its_autopilot(
    tmp_path: Path, flavour: Literal["ardupilot", "px4"]
) -> None:
    with site(tmp_path, flavour, FALLS[flavour]) as rig:
        rig.start()
        assert rig.orders() == 0
        rig.take_off()
        highest_m = rig.height_m()
        assert highest_m > 0.7
        rig.kill()
        heights_m = []
        until(lambda: heights_m.append(rig.height_m()) or heights_m[-1] < 0.05, LIMIT_S)  # type: ignore[func-returns-value]
        assert max(heights_m) < highest_m + 0.4  # it may still be climbing to its last set-point


@pytest.mark.parametrize("flavour", [pytest.param("ardupilot", marks=pytest.mark.slow), "px4"])
def test_a_new_daemon_commands_nothing_until_it_is_resumed(
    tmp_path: Path, flavour: Literal["ardupilot", "px4"]
) -> None:
    with site(tmp_path, flavour, STAYS[flavour]) as rig:
        rig.start()
        rig.take_off()
        rig.kill()
        orders = rig.orders()
        rig.start()
        until(lambda: rig.told().get("flight") == "flying", LIMIT_S)
        until(lambda: rig.told().get("control") == "nobody" and bool(rig.told().get("fit")), LIMIT_S)
        time.sleep(1.0)
        assert rig.orders() == orders
        assert rig.height_m() > 0.7
        rig.order({"command": "resume", "drones": ["d1"]})
        until(lambda: rig.told().get("control") == "planner" and rig.told().get("activity") == "flying", LIMIT_S)
        assert rig.orders() > orders
