"""Where the peers are, and the emulated drones that they fly."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args

import pytest

from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings

Flavour = Literal["ardupilot", "px4"]
FLAVOURS: tuple[Flavour, ...] = get_args(Flavour)
BRISK: dict[str, Any] = {
    "acceleration_m_s2": 4.0,
    "climb_speed_m_s": 2.0,
    "land_speed_m_s": 1.0,
    "land_disarm_s": 0.3,
}
TARGET_NED_M = (1.0, 2.0, -2.0)
HOLD_NOISE_M = 0.1


def need_mavsdk() -> None:
    if importlib.util.find_spec("mavsdk") is None:
        pytest.skip("MAVSDK is not installed: pip install -e '.[peers]'")


def mavproxy() -> str:
    """Return the program; it is GPL and started as a process, never imported."""
    beside = Path(__file__).parents[2] / ".venv-mavproxy" / "bin" / "mavproxy.py"
    found = (
        os.environ.get("CAMRIG_MAVPROXY") or shutil.which("mavproxy.py") or (str(beside) if beside.exists() else None)
    )
    if found is None:
        pytest.skip("MAVProxy is not installed: see tests/peers/mavproxy.txt, or name mavproxy.py in CAMRIG_MAVPROXY")
    return found


@contextmanager
def drone(flavour: Flavour, **settings: Any) -> Iterator[tuple[str, MavlinkDrone]]:
    emulated = MavlinkDrone(MavlinkDroneSettings.model_validate({"flavour": flavour, **BRISK, **settings}), seed=1)
    try:
        yield emulated.start(), emulated
    finally:
        emulated.stop()
