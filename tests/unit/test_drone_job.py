"""What a drone's worker does: operator's orders, hover points while it flies, and a stop ahead of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from camrig.clock import ManualClock
from camrig.errors import HardwareError, LinkLost, NotEnabledError
from camrig.messages import DroneAim, DroneHealth, FlightState
from camrig.runtime.drone_job import DroneJob
from camrig_emulators.fakes import FakeDrone
from tests.runtime_parts import in_a_thread, nothing

HOVER = DroneAim((2.0, 1.0, 1.5), 0.3)


@pytest.fixture
def flyer(fake_drone: FakeDrone, manual_clock: ManualClock) -> DroneJob:
    found = DroneJob("d1", fake_drone, manual_clock)
    found.open()
    return found


def flying(job: DroneJob, clock: ManualClock) -> DroneJob:
    job.arm()
    job.turn()
    clock.advance(10.0)
    job.turn()
    assert job.readings.take_all()[-1].flight is FlightState.FLYING
    return job


def flight(job: DroneJob) -> FlightState:
    job.turn()
    return job.readings.take_all()[-1].flight


def test_a_drone_stays_down_until_it_is_armed(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    flyer.commands.put(HOVER)
    assert flight(flyer) is FlightState.GROUND
    manual_clock.advance(60.0)
    assert flight(flyer) is FlightState.GROUND
    assert fake_drone.commands == []  # dropped: it was not flying


def test_orders_are_carried_out_and_hover_points_passed_on(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    flying(flyer, manual_clock)
    flyer.commands.put(DroneAim((1.0, 1.0, 1.5)))
    flyer.commands.put(HOVER)
    flyer.turn()
    assert [aim for _, aim in fake_drone.commands] == [HOVER]
    flyer.land()
    assert flight(flyer) is FlightState.LANDING
    manual_clock.advance(60.0)
    assert flight(flyer) is FlightState.GROUND


def test_landing_drops_the_hover_point_that_waits(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    flying(flyer, manual_clock).commands.put(HOVER)
    flyer.land()
    flyer.turn()
    flyer.commands.put(HOVER)  # control has not heard of it yet
    assert flight(flyer) is FlightState.LANDING
    assert fake_drone.commands == []


def test_a_drone_that_was_stopped_takes_no_hover_point_until_it_is_resumed(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    flying(flyer, manual_clock).commands.put(HOVER)
    flyer.stop()
    flyer.turn()
    flyer.commands.put(HOVER)
    flyer.turn()
    assert fake_drone.commands == []
    flyer.resume()
    flyer.turn()
    flyer.commands.put(HOVER)
    flyer.turn()
    assert [aim for _, aim in fake_drone.commands] == [HOVER]


def test_a_stop_goes_ahead_of_an_order_that_waits(flyer: DroneJob, manual_clock: ManualClock) -> None:
    flyer.arm()
    flyer.stop()
    flyer.turn()
    manual_clock.advance(10.0)
    assert flight(flyer) is FlightState.GROUND
    assert flying(flyer, manual_clock)  # an arm after the stop counts again


@dataclass
class Arming:
    """A drone that refuses to be armed where ``error`` says why; another thread does ``doing`` in the midst of it."""

    drone: FakeDrone
    error: HardwareError | None = None
    doing: Callable[[], None] = nothing

    def arm(self) -> None:
        in_a_thread(self.doing)
        if self.error is not None:
            raise self.error
        self.drone.arm()

    def resume(self) -> None:
        self.drone.resume()

    def open(self) -> None:
        self.drone.open()

    def go_to(self, position_m: tuple[float, float, float], yaw_rad: float) -> None:
        self.drone.go_to(position_m, yaw_rad)

    def land(self) -> None:
        self.drone.land()

    def read(self, timeout_s: float) -> tuple[()]:
        return ()

    def stop(self) -> None:
        self.drone.stop()

    def close(self) -> None:
        self.drone.close()


def test_a_stop_in_the_midst_of_arming_has_the_last_word(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    drone = Arming(fake_drone)
    job = DroneJob("d1", drone, manual_clock)
    drone.doing = job.stop
    job.arm()
    job.turn()
    manual_clock.advance(10.0)
    assert fake_drone.T_world_body()[2, 3] == 0.0
    job.commands.put(HOVER)
    job.turn()
    assert fake_drone.commands == []


def test_a_refusal_becomes_an_event(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    manual_clock.advance(3.0)
    job = DroneJob("d1", Arming(fake_drone, HardwareError("battery at 12 %, 30 % are needed")), manual_clock)
    job.arm()
    job.turn()
    (event,) = job.refusals.take_all()
    assert (event.about, event.text, event.stamp_s) == ("d1", "battery at 12 %, 30 % are needed", 3.0)


def test_a_link_lost_under_an_order_is_the_workers_to_reopen(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    job = DroneJob("d1", fake_drone, manual_clock)
    job.arm()
    fake_drone.faults.unplug()
    with pytest.raises(LinkLost):
        job.turn()
    assert job.refusals.take_all() == ()


def test_no_order_outlives_its_link(flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    fake_drone.faults.unplug()
    with pytest.raises(LinkLost):
        flyer.turn()
    flyer.close()
    flyer.arm()
    flyer.commands.put(HOVER)
    fake_drone.faults.replug()
    flyer.open()
    flyer.turn()
    manual_clock.advance(10.0)
    assert flight(flyer) is FlightState.GROUND
    assert fake_drone.commands == []
    assert not flyer.enabled
    (event,) = flyer.refusals.take_all()
    assert "order it again" in event.text


def test_what_was_in_the_air_when_its_link_was_lost_is_not_taken_to_have_landed(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    assert flyer.flight is None
    flying(flyer, manual_clock)
    fake_drone.faults.unplug()
    with pytest.raises(LinkLost):
        flyer.turn()
    flyer.close()
    assert flyer.flight is FlightState.FLYING
    fake_drone.faults.replug()
    flyer.open()
    flyer.land()
    flyer.turn()
    manual_clock.advance(30.0)
    flyer.turn()
    assert flyer.flight is FlightState.GROUND


@dataclass
class Ailing:
    """A drone that tells how it is; a test says how."""

    drone: FakeDrone
    told: DroneHealth = field(default_factory=lambda: DroneHealth("passive", obeys=False))

    def health(self) -> DroneHealth:
        return self.told

    def arm(self) -> None:
        self.told = DroneHealth("climbing", obeys=False, begins=True)

    def resume(self) -> None:
        self.told = DroneHealth("flying", obeys=True)

    def open(self) -> None:
        self.drone.open()

    def go_to(self, position_m: tuple[float, float, float], yaw_rad: float) -> None:
        raise NotEnabledError("not now")

    def land(self) -> None:
        self.told = DroneHealth("landing", obeys=False)

    def read(self, timeout_s: float) -> tuple[()]:
        return ()

    def stop(self) -> None:
        self.told = DroneHealth("holding", obeys=False)

    def close(self) -> None:
        self.told = DroneHealth("passive", obeys=False)


def test_a_sick_drone_leaves_the_plans_in_the_turn_that_finds_it(
    fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    drone = Ailing(fake_drone)
    job = DroneJob("d1", drone, manual_clock)
    job.turn()
    job.arm()
    job.turn()
    assert job.begins
    assert not job.follows_plans  # it climbs
    drone.told = DroneHealth("flying", obeys=True)
    job.turn()
    assert job.follows_plans
    drone.told = DroneHealth("holding", obeys=False, reason="its position jumped by 1.0 m: it holds")
    job.commands.put(HOVER)
    job.turn()
    assert not job.follows_plans
    (event,) = job.refusals.take_all()
    assert event.text == "left out of plans until `camrig resume d1`: its position jumped by 1.0 m: it holds"
    job.turn()
    assert job.refusals.take_all() == ()
    job.resume()
    job.turn()
    assert job.follows_plans


def test_a_drone_that_its_driver_lands_for_a_fault_counts_as_landing_until_it_is_stopped(
    fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    """A daemon that ends stops all drones but those: held with an empty battery, it would fall down."""
    drone = Ailing(fake_drone)
    job = DroneJob("d1", drone, manual_clock)
    job.resume()
    job.turn()
    assert not job.landing
    drone.told = DroneHealth("descending", obeys=False, lands=True, reason="battery at 15 %: it lands")
    job.turn()
    assert job.landing
    job.stop()
    job.turn()
    assert not job.landing


def test_a_take_off_that_comes_to_nothing_is_told(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    drone = Ailing(fake_drone)
    job = DroneJob("d1", drone, manual_clock)
    job.turn()
    job.arm()
    job.turn()
    drone.told = DroneHealth("passive", obeys=False, reason="it refuses command 400 with result 4: battery low")
    job.turn()
    assert not job.enabled
    assert "it refuses command 400" in job.refusals.take_all()[0].text
