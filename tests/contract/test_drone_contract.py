"""What every drone must do, whatever it is made of: one class, run on the fake and over UDP on both autopilots.

Flights are long, so a test is a whole flight; times are limits, never waits.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from typing import Literal, Protocol

import numpy as np
import pytest

from camrig.errors import HardwareError, InputError, LinkLost, NotEnabledError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import difference
from camrig.geometry.rotation import wrap_angle, yaw_of
from camrig.interfaces import Drone
from camrig.messages import DroneReading, FlightState
from camrig.rig import DroneSpec
from camrig_drivers.mavlink import driver
from camrig_emulators.fakes import FakeDrone
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink_drone import MavlinkDrone as EmulatedDrone
from camrig_emulators.mavlink_drone import MavlinkDroneSettings

SPEC = DroneSpec("d1", ((0.0, 0.0, 0.6), (5.0, 3.0, 2.5)), min_separation_m=0.8, speed_m_s=2.0)
START_M = (1.0, 1.0, 0.0)
NEAR_M, FAR_M = (1.6, 1.3, 0.8), (4.5, 2.5, 0.8)
FLIGHT = [FlightState.TAKING_OFF, FlightState.FLYING, FlightState.LANDING]
LIMIT_S = 15.0
REACHED_M = 0.15
ARRIVAL_S = 0.2
"""A datagram that has been sent has been heard by then."""
FAILSAFES = {
    "ardupilot": {"FS_GCS_ENABLE": 5.0, "GUID_TIMEOUT": 1.0},
    "px4": {"COM_OBL_RC_ACT": 4.0, "NAV_DLL_ACT": 3.0},
}
UPKEEP = {511, 512}
TRUTH_M = 0.06
"""Over three sigma of the emulator's estimate, 1 cm an axis, and 10 ms of flight."""


class DroneRig(Protocol):
    """A drone under test, and what an observer beside it sees."""

    drone: Drone
    faults: Faults

    def true_pose(self, stamp_s: float) -> Transform:
        """Return where it truly was."""
        ...

    def orders(self) -> int:
        """Count what it has been told to do: commands and set-points, but no questions and wishes for telemetry."""
        ...

    def take_down(self) -> None:
        """End the far end."""
        ...


class FakeRig:
    """The drone in memory."""

    def __init__(self) -> None:
        self._fake = FakeDrone(SPEC, start_m=START_M, period_s=0.02)
        self.drone: Drone = self._fake
        self.faults = self._fake.faults

    def true_pose(self, stamp_s: float) -> Transform:
        del stamp_s  # it knows its present place only, which is where it was when it was read
        return self._fake.T_world_body()

    def orders(self) -> int:
        return len(self._fake.commands)

    def take_down(self) -> None:
        pass


class MavlinkRig:
    """The MAVLink driver and the emulated autopilot, over UDP."""

    def __init__(self, flavour: Literal["ardupilot", "px4"]) -> None:
        origin_m = (0.5, 0.2, 0.0)
        settings = MavlinkDroneSettings(
            flavour=flavour,
            start_position_m=START_M,
            start_yaw_deg=20.0,
            origin_m=origin_m,
            max_speed_m_s=4.0,
            climb_speed_m_s=3.0,
            land_speed_m_s=2.0,
            acceleration_m_s2=6.0,
            land_disarm_s=0.2,
            params=FAILSAFES[flavour],
        )
        self._emulator = EmulatedDrone(settings, seed=1)
        self.faults = self._emulator.faults
        section = driver.section(url=self._emulator.start(), origin_m=origin_m)
        self.drone: Drone = driver.make({SPEC.id: (SPEC, section)})[SPEC.id]

    def true_pose(self, stamp_s: float) -> Transform:
        return self._emulator.T_world_body(stamp_s)

    def orders(self) -> int:
        said = [(message.name, message.fields.get("command")) for message in self._emulator.received]
        orders = {"COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_LOCAL_NED", "PARAM_SET"}
        return sum(name in orders and command not in UPKEEP for name, command in said)

    def take_down(self) -> None:
        self._emulator.stop()


RIGS: dict[str, Callable[[], DroneRig]] = {
    "fake": FakeRig,
    "ardupilot": lambda: MavlinkRig("ardupilot"),
    "px4": lambda: MavlinkRig("px4"),
}


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest) -> Iterator[DroneRig]:
    """Return a drone, not open yet."""
    made = RIGS[request.param]()
    yield made
    made.drone.close()
    made.take_down()


class Pilot:
    """Reads the drone as its worker does, holding every reading against the truth."""

    def __init__(self, rig: DroneRig) -> None:
        self.rig = rig
        self.drone = rig.drone
        self.states: list[FlightState] = []
        self.errors_m: list[float] = []
        self.errors_rad: list[float] = []
        self.latest: DroneReading | None = None
        self.refusal = ""

    def read(self) -> None:
        for reading in self.drone.read(0.1):
            truth = self.rig.true_pose(reading.stamp_s)
            assert reading.covariance.shape == (6, 6)
            assert self.latest is None or reading.stamp_s > self.latest.stamp_s
            self.errors_m.append(math.dist(truth[:3, 3], reading.T_world_body[:3, 3]))
            self.errors_rad.append(float(np.linalg.norm(difference(truth, reading.T_world_body)[3:])))
            self.latest = reading
            if self.states[-1:] != [reading.flight]:
                self.states.append(reading.flight)

    def until(self, holds: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s:
            self.read()
            if holds():
                return True
        return False

    def watch(self, duration_s: float) -> None:
        self.until(lambda: False, duration_s)

    def place_m(self) -> Array:
        return np.asarray(self.rig.true_pose(time.monotonic())[:3, 3])

    def is_at(self, place_m: tuple[float, float, float]) -> bool:
        return math.dist(self.place_m(), place_m) <= REACHED_M

    def may_go(self) -> bool:
        """Whether the drone takes orders; telling it to stay where it is as the first one."""
        x, y, z = (float(min(max(v, a), b)) for v, a, b in zip(self.place_m(), *SPEC.box_m, strict=True))
        try:
            self.drone.go_to((x, y, z), 0.0)
        except NotEnabledError:
            return False
        return True

    def take_off(self) -> None:
        self.drone.open()
        assert self.until(self.may_arm), self.refusal
        assert self.until(self.may_go), self.states

    def may_arm(self) -> bool:
        """Whether it takes the order to arm, once it has told all that must be known before."""
        try:
            self.drone.arm()
        except HardwareError as error:
            self.refusal = str(error)
            return False
        return True


@pytest.fixture
def pilot(rig: DroneRig) -> Pilot:
    return Pilot(rig)


class TestDrone:
    """The contract of camrig.interfaces.Drone."""

    def test_opening_moves_nothing(self, pilot: Pilot) -> None:
        pilot.drone.open()
        pilot.watch(0.3)
        assert pilot.states == [FlightState.GROUND]
        assert pilot.rig.orders() == 0
        assert pilot.is_at(START_M)
        with pytest.raises(HardwareError, match="not in the air"):
            pilot.drone.resume()

    def test_nothing_is_taken_before_arming(self, pilot: Pilot) -> None:
        pilot.drone.open()
        pilot.watch(0.2)
        with pytest.raises(NotEnabledError, match="it first"):
            pilot.drone.go_to(NEAR_M, 0.0)
        pilot.watch(0.2)
        assert pilot.rig.orders() == 0

    @pytest.mark.parametrize("place_m", [(1.0, 1.0, 0.5), (5.1, 1.0, 1.5), (1.0, -0.1, 1.5), (1.0, 1.0, math.nan)])
    def test_box_is_refused_before_and_after_opening(self, pilot: Pilot, place_m: tuple[float, float, float]) -> None:
        with pytest.raises(InputError, match="outside its box"):
            pilot.drone.go_to(place_m, 0.0)
        pilot.drone.open()
        with pytest.raises(InputError, match="outside its box"):
            pilot.drone.go_to(place_m, 0.0)

    def test_flight(self, pilot: Pilot) -> None:
        drone = pilot.drone
        pilot.take_off()
        drone.go_to(NEAR_M, 0.8)
        assert pilot.until(lambda: pilot.is_at(NEAR_M))
        assert pilot.until(lambda: abs(wrap_angle(yaw_of(pilot.rig.true_pose(time.monotonic())) - 0.8)) < 0.05)

        drone.go_to(FAR_M, 0.8)
        assert pilot.until(lambda: pilot.place_m()[0] > 2.2)
        stopped_m = pilot.place_m()
        drone.stop()
        assert not pilot.may_go()
        pilot.watch(0.3)
        assert math.dist(pilot.place_m(), stopped_m) < 0.5  # it had to brake
        assert pilot.until(lambda: math.dist(pilot.place_m(), stopped_m) < 0.05, 3.0)
        pilot.watch(0.3)
        assert math.dist(pilot.place_m(), stopped_m) < REACHED_M
        assert not pilot.may_go()

        with pytest.raises(HardwareError, match="in the air"):
            drone.arm()
        drone.resume()
        assert pilot.until(pilot.may_go, 2.0)
        assert math.dist(pilot.place_m(), stopped_m) < REACHED_M
        drone.land()
        assert pilot.until(lambda: pilot.states[-1] is FlightState.GROUND)
        assert pilot.place_m()[2] < 0.1
        assert not pilot.may_go()

        assert pilot.states == [FlightState.GROUND, *FLIGHT, FlightState.GROUND]
        assert max(pilot.errors_m) < TRUTH_M
        assert float(np.mean(pilot.errors_rad)) < math.radians(0.5)

    def test_nothing_is_resumed(self, pilot: Pilot) -> None:
        """Neither after closing in the air, nor after the link was lost in flight."""
        drone = pilot.drone
        pilot.take_off()
        drone.go_to(FAR_M, 0.0)
        assert pilot.until(lambda: pilot.place_m()[0] > 1.5)
        drone.close()
        drone.close()
        time.sleep(ARRIVAL_S)
        orders = pilot.rig.orders()
        left_m = pilot.place_m()
        drone.open()
        pilot.watch(0.8)
        assert pilot.rig.orders() == orders
        assert not pilot.may_go()
        assert math.dist(pilot.place_m(), left_m) < 0.5
        assert pilot.place_m()[2] > 0.4

        drone.resume()
        assert pilot.until(pilot.may_go, 4.0), pilot.states
        drone.go_to(FAR_M, 0.0)
        pilot.watch(0.3)
        pilot.rig.faults.unplug()
        with pytest.raises(LinkLost):
            pilot.watch(5.0)
        drone.stop()
        pilot.rig.faults.replug()
        time.sleep(ARRIVAL_S)
        orders = pilot.rig.orders()
        drone.close()
        self._reopen(drone)
        pilot.latest = None
        pilot.watch(0.3)
        assert not pilot.may_go()
        assert pilot.rig.orders() == orders

    def test_stop_and_close_in_any_state(self, pilot: Pilot) -> None:
        pilot.drone.stop()
        pilot.drone.close()
        pilot.drone.open()
        pilot.drone.stop()
        pilot.drone.close()
        pilot.drone.stop()
        pilot.drone.close()
        assert pilot.rig.orders() == 0

    @staticmethod
    def _reopen(drone: Drone) -> None:
        for _ in range(20):
            with contextlib.suppress(LinkLost):
                return drone.open()
            time.sleep(0.1)
        return drone.open()
