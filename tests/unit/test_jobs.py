"""What the workers do with heads, drones and cameras, on the fakes: who may move when, and who has the last word."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import EndOfInput, HardwareError, LinkLost
from camrig.geometry.arrays import GreyImage
from camrig.interfaces import Guard
from camrig.messages import DroneAim, Expected, FlightState, HeadAim, TagDetection
from camrig.runtime.guardian_link import GuardianLink
from camrig.runtime.jobs import WHOLE_EVERY_S, CameraJob, DroneJob, HeadJob
from camrig_emulators.fakes import FakeCamera, FakeDrone, FakeHead
from tests.runtime_parts import until

ASIDE, BELOW = HeadAim(0.5, -0.5), HeadAim(0.0, -1.5)

# --- heads ----------------------------------------------------------------------------------------------------


@pytest.fixture
def guardian() -> Iterator[GuardianLink]:
    link = GuardianLink()
    yield link
    link.close()


def head_job(head: FakeHead, guardian: GuardianLink, *, auto: bool = False) -> HeadJob:
    return HeadJob("pt1", head, guardian, auto_enable=auto)


@pytest.fixture
def job(fake_head: FakeHead, guardian: GuardianLink) -> Iterator[HeadJob]:
    """Return an open job of a head that nobody has enabled."""
    found = head_job(fake_head, guardian)
    found.open()
    yield found
    found.close()


def moves(head: FakeHead) -> list[HeadAim | None]:
    return [aim for _, aim in head.commands]


def test_nothing_moves_before_it_is_enabled(job: HeadJob, fake_head: FakeHead) -> None:
    job.commands.put(ASIDE)
    job.turn()
    assert moves(fake_head) == []
    assert not job.enabled
    assert not fake_head.enabled
    assert {reading.axis for reading in job.readings.take_all()} == {"pan", "tilt"}


def test_a_command_made_before_enabling_is_dropped_and_the_next_is_obeyed(job: HeadJob, fake_head: FakeHead) -> None:
    job.commands.put(ASIDE)
    job.resume()
    job.turn()
    assert job.enabled
    assert moves(fake_head) == []
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head) == [BELOW]


def test_one_that_starts_by_itself_is_enabled_with_its_first_turn_and_not_by_opening(
    fake_head: FakeHead, guardian: GuardianLink
) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    assert not fake_head.enabled
    assert not job.enabled
    job.turn()
    assert fake_head.enabled
    assert job.enabled
    job.close()


def test_only_the_newest_command_is_sent(job: HeadJob, fake_head: FakeHead) -> None:
    job.resume()
    job.turn()
    job.commands.put(ASIDE)
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head) == [BELOW]


def test_a_stop_disables_and_clears_what_waits(job: HeadJob, fake_head: FakeHead) -> None:
    job.resume()
    job.turn()
    job.commands.put(ASIDE)
    stopper = threading.Thread(target=job.stop)
    stopper.start()
    stopper.join()
    assert not job.enabled
    job.turn()
    job.turn()
    assert moves(fake_head) == [None]
    assert not fake_head.enabled


def _nothing() -> None:
    """Do nothing."""


def _in_a_thread(doing: Callable[[], None]) -> None:
    thread = threading.Thread(target=doing)
    thread.start()
    thread.join()


@dataclass
class Meanwhile:
    """A head to which another thread does something just before or after it is enabled; ``wire`` is its port."""

    head: FakeHead
    before: Callable[[], None] = _nothing
    after: Callable[[], None] = _nothing
    wire: int = -1

    def enable(self) -> None:
        _in_a_thread(self.before)
        self.head.enable()
        _in_a_thread(self.after)

    def open(self) -> None:
        self.head.open()

    def move_to(self, pan_rad: float, tilt_rad: float) -> None:
        self.head.move_to(pan_rad, tilt_rad)

    def read(self, timeout_s: float) -> tuple[()]:
        return ()

    def guard(self) -> Guard:
        return Guard(self.wire, b"stop") if self.wire >= 0 else self.head.guard()

    def stop(self) -> None:
        self.head.stop()

    def close(self) -> None:
        self.head.close()


@pytest.mark.parametrize("moment", ["before", "after"])
def test_a_stop_in_the_midst_of_enabling_has_the_last_word(
    fake_head: FakeHead, guardian: GuardianLink, moment: str
) -> None:
    head = Meanwhile(fake_head)
    job = HeadJob("pt1", head, guardian, auto_enable=True)
    setattr(head, moment, job.stop)
    job.open()
    job.turn()
    assert not job.enabled
    assert not fake_head.enabled
    job.commands.put(ASIDE)
    job.turn()
    assert set(moves(fake_head)) == {None}
    job.close()


def test_a_head_held_and_resumed_in_the_midst_of_enabling_moves_again(
    fake_head: FakeHead, guardian: GuardianLink
) -> None:
    head = Meanwhile(fake_head)
    job = HeadJob("pt1", head, guardian, auto_enable=True)

    def hold_and_resume() -> None:
        job.stop()
        job.resume()

    head.after = hold_and_resume
    job.open()
    job.turn()
    head.after = _nothing
    for _ in range(3):
        job.commands.put(ASIDE)
        job.turn()
    assert moves(fake_head)[-1] == ASIDE
    job.close()


def test_no_move_follows_a_stop_however_the_threads_meet(job: HeadJob, fake_head: FakeHead) -> None:
    ending = threading.Event()

    def work() -> None:
        while not ending.is_set():
            job.commands.put(ASIDE)
            job.turn()
            job.readings.clear()

    worker = threading.Thread(target=work)
    worker.start()
    try:
        for _ in range(100):
            before = len(fake_head.commands)
            job.resume()
            until(lambda before=before: ASIDE in moves(fake_head)[before:])  # type: ignore[misc]
            job.stop()
            stopped = len(fake_head.commands)
            time.sleep(0.001)
            assert ASIDE not in moves(fake_head)[stopped:]
    finally:
        ending.set()
        worker.join()


def test_nothing_commanded_before_a_lost_link_is_replayed(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    job.turn()
    fake_head.faults.unplug()
    job.commands.put(ASIDE)
    with pytest.raises(LinkLost):
        job.turn()
    job.commands.put(ASIDE)  # control has not heard of it yet
    job.close()
    assert not job.enabled
    fake_head.faults.replug()
    job.open()
    job.commands.put(ASIDE)  # nor of the new link
    job.turn()
    job.turn()
    assert ASIDE not in moves(fake_head)
    assert job.enabled
    job.commands.put(BELOW)
    job.turn()
    assert moves(fake_head)[-1] == BELOW
    job.close()


def test_a_head_held_while_its_link_was_lost_stays_held(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian, auto=True)
    job.open()
    job.turn()
    fake_head.faults.unplug()
    with pytest.raises(LinkLost):
        job.turn()
    job.close()
    job.stop()
    fake_head.faults.replug()
    job.open()
    job.commands.put(ASIDE)
    job.turn()
    assert not job.enabled
    assert ASIDE not in moves(fake_head)
    job.close()


def test_the_guardian_stops_an_open_head_when_the_daemon_dies(fake_head: FakeHead, guardian: GuardianLink) -> None:
    job = head_job(fake_head, guardian)
    job.open()
    guardian.close()
    assert fake_head.guarded() == b"stop" * 3
    job.close()


def test_the_guardian_lets_go_of_a_closed_head(fake_head: FakeHead, guardian: GuardianLink) -> None:
    reader, writer = os.pipe()
    job = HeadJob("pt1", Meanwhile(fake_head, wire=writer), guardian, auto_enable=True)
    job.open()
    job.turn()
    job.close()
    guardian.close()
    os.close(writer)
    assert os.read(reader, 64) == b""
    os.close(reader)


def test_a_head_is_not_served_without_its_guardian(fake_head: FakeHead, guardian: GuardianLink) -> None:
    guardian.close()
    job = head_job(fake_head, guardian, auto=True)
    with pytest.raises(HardwareError, match=r"guardian process is gone .*'pt1' must not be enabled"):
        job.open()
    job.close()


# --- drones ---------------------------------------------------------------------------------------------------

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


def test_a_drone_that_was_stopped_takes_no_hover_point_until_it_is_armed_again(
    flyer: DroneJob, fake_drone: FakeDrone, manual_clock: ManualClock
) -> None:
    flying(flyer, manual_clock).commands.put(HOVER)
    flyer.stop()
    flyer.turn()
    flyer.commands.put(HOVER)
    flyer.turn()
    assert fake_drone.commands == []
    flyer.arm()
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
    doing: Callable[[], None] = _nothing

    def arm(self) -> None:
        _in_a_thread(self.doing)
        if self.error is not None:
            raise self.error
        self.drone.arm()

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


# --- cameras --------------------------------------------------------------------------------------------------

WHOLE = (480, 640)


@dataclass
class SeenPictures:
    """A detector that finds nothing and remembers the shape of every picture it was shown."""

    shapes: list[tuple[int, ...]] = field(default_factory=list)

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        self.shapes.append(image.shape)
        return ()


@dataclass
class Eye:
    """A camera's job under test, and what its detector saw."""

    job: CameraJob
    camera: FakeCamera
    detectors: list[SeenPictures]

    def look(self, *stamps_s: float) -> list[tuple[int, ...]]:
        """Take frames of these stamps; return the shapes of the pictures that were searched."""
        seen = self.detectors[-1].shapes
        seen.clear()
        for stamp_s in stamps_s:
            self.camera.push(np.zeros(WHOLE, np.uint8), stamp_s)
            self.job.turn()
        return list(seen)


@pytest.fixture
def eye(manual_clock: ManualClock) -> Eye:
    camera = FakeCamera("north", clock=manual_clock)
    detectors: list[SeenPictures] = []

    def make() -> SeenPictures:
        detectors.append(SeenPictures())
        return detectors[-1]

    job = CameraJob("north", camera, make, manual_clock)
    job.open()
    return Eye(job, camera, detectors)


REGIONS = ((100, 50, 164, 98), (300, 200, 340, 240))


def in_parts(shapes: list[tuple[int, ...]]) -> bool:
    """Tell whether only parts about as large as the regions were searched."""
    return len(shapes) == len(REGIONS) and all(height <= 64 and width <= 80 for height, width in shapes)


def test_without_expectations_the_whole_picture_is_searched(eye: Eye) -> None:
    assert eye.look(0.0, 0.1) == [WHOLE, WHOLE]
    found = eye.job.detections.take_all()
    assert [(detections.stamp_s, detections.whole) for detections in found] == [(0.0, True), (0.1, True)]
    assert (eye.job.frames, eye.job.whole_frames) == (2, 2)


def test_regions_are_searched_only_while_they_hold(eye: Eye) -> None:
    eye.look(0.0)
    eye.job.expected.put(Expected("north", 0.10, 0.20, REGIONS))
    assert eye.look(0.05) == [WHOLE]
    assert in_parts(eye.look(0.10))
    assert in_parts(eye.look(0.20))
    assert eye.look(0.25) == [WHOLE]
    eye.job.expected.put(Expected("north", 0.0, 9.0, REGIONS))
    assert in_parts(eye.look(0.3))
    eye.job.expected.clear()
    assert eye.look(0.35) == [WHOLE]


def test_the_whole_picture_is_searched_twice_a_second_whatever_is_expected(eye: Eye) -> None:
    eye.job.expected.put(Expected("north", -1.0, 99.0, REGIONS))
    whole = [stamp_s for k in range(41) for stamp_s in [0.05 * k] if WHOLE in eye.look(stamp_s)]
    assert whole == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    assert eye.job.whole_frames == 5
    assert eye.job.frames == 41
    assert WHOLE_EVERY_S == 0.5


def test_a_camera_without_a_frame_detects_nothing(eye: Eye) -> None:
    eye.job.wake()
    eye.job.turn()
    assert eye.job.detections.take_all() == ()
    assert eye.job.frames == 0


def test_its_detector_outlives_a_lost_link(eye: Eye) -> None:
    eye.camera.faults.unplug()
    with pytest.raises(LinkLost):
        eye.job.turn()
    eye.job.close()
    eye.camera.faults.replug()
    eye.job.open()
    assert eye.look(1.0) == [WHOLE]
    assert len(eye.detectors) == 1


def test_the_end_of_a_recording_is_passed_on_after_its_last_frame(eye: Eye) -> None:
    eye.camera.push(np.zeros(WHOLE, np.uint8), 0.0)
    eye.camera.end()
    eye.job.turn()
    assert len(eye.job.detections.take_all()) == 1
    with pytest.raises(EndOfInput):
        eye.job.turn()


def test_a_camera_waiting_for_a_frame_can_be_woken(eye: Eye) -> None:
    waiter = threading.Thread(target=eye.job.turn)
    began_s = time.monotonic()
    waiter.start()
    eye.job.wake()
    waiter.join()
    assert time.monotonic() - began_s < 0.4  # its time-out is 0.5 s
