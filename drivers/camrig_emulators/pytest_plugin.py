"""Pytest fixtures for suites that test against camrig's fakes and emulators; see docs/how-to-test-with-camrig.md.

Loaded in every pytest run wherever camrig is installed, so nothing but pytest is imported before a fixture is used.
"""
# ruff: noqa: PLC0415

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from camrig.clock import ManualClock
    from camrig.config.rig_file import RigConfig
    from camrig_emulators.fakes import FakeDrone, FakeHead
    from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings
    from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine
    from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine, ViscaUdpHead
    from camrig_emulators.world import EmulatedWorld


@pytest.fixture
def manual_clock() -> ManualClock:
    """Return a clock that moves only when the test says so."""
    from camrig.clock import ManualClock

    return ManualClock()


@pytest.fixture
def pelco_d_emulator() -> Iterator[Callable[..., PelcoDLine]]:
    """Return ``start(*heads, seed=0, script="")``: PelcoDHeadSettings (none = one plain head) on one ``.port``."""
    from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

    with ExitStack() as stack:

        def start(*heads: PelcoDHeadSettings, seed: int = 0, script: str = "") -> PelcoDLine:
            line = PelcoDLine(heads or [PelcoDHeadSettings(id="head")], seed=seed, script=script)
            stack.callback(line.stop)
            line.start()
            return line

        yield start


@pytest.fixture
def visca_emulator() -> Iterator[Callable[..., ViscaLine]]:
    """Return ``start(*heads, seed=0)``: heads (ViscaHeadSettings; none = one plain head) on one port, ``.port``."""
    from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine

    with ExitStack() as stack:

        def start(*heads: ViscaHeadSettings, seed: int = 0) -> ViscaLine:
            line = ViscaLine(heads or [ViscaHeadSettings(id="head")], seed=seed)
            stack.callback(line.stop)
            line.start()
            return line

        yield start


@pytest.fixture
def visca_udp_emulator() -> Iterator[Callable[..., ViscaUdpHead]]:
    """Return ``start(settings=None, sony=True, seed=0)``: a head on UDP with Sony's header or without, ``.port``."""
    from camrig_emulators.visca_head import ViscaHeadSettings, ViscaUdpHead

    with ExitStack() as stack:

        def start(settings: ViscaHeadSettings | None = None, *, sony: bool = True, seed: int = 0) -> ViscaUdpHead:
            head = ViscaUdpHead(settings or ViscaHeadSettings(id="head"), sony=sony, seed=seed)
            stack.callback(head.stop)
            head.start()
            return head

        yield start


@pytest.fixture
def drone_emulator() -> Iterator[Callable[..., tuple[str, MavlinkDrone]]]:
    """Return ``start(settings=None, seed=None)``: a drone (MavlinkDroneSettings; none = on UDP), as (url, drone)."""
    from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings

    with ExitStack() as stack:

        def start(settings: MavlinkDroneSettings | None = None, seed: int | None = None) -> tuple[str, MavlinkDrone]:
            drone = MavlinkDrone(settings or MavlinkDroneSettings(), seed=seed)
            stack.callback(drone.stop)
            return drone.start(), drone

        yield start


@pytest.fixture
def emulated_world() -> Iterator[Callable[[Path], tuple[RigConfig, EmulatedWorld]]]:
    """Return ``start(config_file)``: a rig's emulated world, as (configuration with ports filled in, world)."""
    from camrig.config.rig_file import load_rig
    from camrig.errors import InputError
    from camrig.runtime.emulated import emulated_world as running
    from camrig_emulators.world import EmulatedWorld

    with ExitStack() as stack:

        def start(config_file: Path) -> tuple[RigConfig, EmulatedWorld]:
            config, world = stack.enter_context(running(load_rig(config_file)))
            if not isinstance(world, EmulatedWorld):
                raise InputError(f"{config_file} has no emulated world; give it a section world: with driver: emulated")
            return config, world

        yield start


@pytest.fixture
def fake_head(manual_clock: ManualClock) -> Iterator[FakeHead]:
    """Return an open head in memory on ``manual_clock``: pan +-170, tilt -90 to 20 deg, 40 deg/s, at rest at zero."""
    import numpy as np

    from camrig.geometry.pan_tilt import PanTilt
    from camrig.rig import HeadSpec
    from camrig_emulators.fakes import FakeHead

    limits = (math.radians(-170.0), math.radians(170.0)), (math.radians(-90.0), math.radians(20.0))
    head = FakeHead(HeadSpec("head", PanTilt(np.eye(4)), *limits, math.radians(40.0)), clock=manual_clock)
    head.open()
    yield head
    head.close()


@pytest.fixture
def fake_drone(manual_clock: ManualClock) -> Iterator[FakeDrone]:
    """Return an open drone in memory on ``manual_clock``: box 5 x 3 m, 1 to 2.5 m high, 0.5 m/s, on the ground."""
    from camrig.rig import DroneSpec
    from camrig_emulators.fakes import FakeDrone

    box_m = ((0.0, 0.0, 1.0), (5.0, 3.0, 2.5))
    drone = FakeDrone(DroneSpec("drone", box_m, min_separation_m=0.8, speed_m_s=0.5), clock=manual_clock)
    drone.open()
    yield drone
    drone.close()
