"""The in-memory fakes keep the rules of camrig.interfaces on a manual clock."""

from __future__ import annotations

import math
import os
import threading
import time

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import EndOfInput, InputError, LinkLost, NotEnabledError
from camrig.geometry.lens import BrownLens
from camrig.interfaces import Camera, Drone, Head
from camrig.messages import FlightState
from camrig.rig import CameraSpec, FreeMount
from camrig_emulators.fakes import FakeCamera, FakeDrone, FakeHead, camera_driver, drone_driver, head_driver

GREY = np.full((24, 32), 7, np.uint8)


def test_the_fakes_are_what_they_fake(fake_head: FakeHead, fake_drone: FakeDrone) -> None:
    head: Head = fake_head
    drone: Drone = fake_drone
    camera: Camera = FakeCamera("c")
    assert head
    assert drone
    assert camera


# --- head -----------------------------------------------------------------------------------------------------


def aim(head: FakeHead) -> tuple[float, ...]:
    return tuple(reading.angle_rad for reading in head.read(1.0))


def test_a_head_moves_only_when_enabled(fake_head: FakeHead, manual_clock: ManualClock) -> None:
    with pytest.raises(NotEnabledError, match="head is not enabled"):
        fake_head.move_to(0.5, 0.0)
    fake_head.enable()
    manual_clock.advance(5.0)
    assert aim(fake_head) == (0.0, 0.0)
    fake_head.move_to(0.5, -0.5)
    manual_clock.advance(5.0)
    assert aim(fake_head) == (0.5, -0.5)
    assert [reading.stamp_s for reading in fake_head.read(1.0)] == [10.0, 10.0]


def test_a_head_takes_the_time_of_its_speed(fake_head: FakeHead, manual_clock: ManualClock) -> None:
    fake_head.enable()
    fake_head.move_to(2.0, 0.0)
    manual_clock.advance(1.0)
    assert 0.0 < aim(fake_head)[0] < math.radians(40.0)


def test_stop_ends_motion_and_disables(fake_head: FakeHead, manual_clock: ManualClock) -> None:
    fake_head.enable()
    fake_head.move_to(2.0, 0.0)
    manual_clock.advance(1.0)
    fake_head.stop()
    manual_clock.advance(1.0)
    rest = aim(fake_head)
    manual_clock.advance(10.0)
    assert aim(fake_head) == rest
    assert rest[0] < 2.0
    assert not fake_head.enabled
    assert [aim for _, aim in fake_head.commands][-1] is None
    with pytest.raises(NotEnabledError):
        fake_head.move_to(0.0, 0.0)


def test_a_head_refuses_what_is_outside_its_limits(fake_head: FakeHead) -> None:
    fake_head.enable()
    with pytest.raises(InputError, match=r"tilt 0\.5000 rad is outside -1\.5708 to 0\.3491 rad"):
        fake_head.move_to(0.0, 0.5)


def test_an_unplugged_head_is_lost_until_replugged_and_stop_does_not_mind(fake_head: FakeHead) -> None:
    fake_head.enable()
    fake_head.faults.unplug()
    for call in (lambda: fake_head.read(0.1), lambda: fake_head.move_to(0.0, 0.0), fake_head.open):
        with pytest.raises(LinkLost):
            call()
    fake_head.stop()
    fake_head.close()
    fake_head.faults.replug()
    fake_head.open()
    assert aim(fake_head) == (0.0, 0.0)


def test_silent_and_frozen_heads(fake_head: FakeHead, manual_clock: ManualClock) -> None:
    fake_head.faults.silent = True
    assert fake_head.read(0.1) == ()
    fake_head.faults.silent = False
    before = fake_head.read(0.1)
    fake_head.faults.freeze = True
    manual_clock.advance(1.0)
    assert fake_head.read(0.1) == before


def test_a_guardian_can_write_to_an_open_head_and_to_no_other(fake_head: FakeHead) -> None:
    guard = fake_head.guard()
    assert fake_head.guarded() == b""
    os.write(guard.fd, guard.stop_bytes)
    assert fake_head.guarded() == guard.stop_bytes
    fake_head.close()
    fake_head.close()
    with pytest.raises(LinkLost, match="not open"):
        fake_head.guard()


# --- drone ----------------------------------------------------------------------------------------------------


def fly(drone: FakeDrone, clock: ManualClock) -> None:
    drone.arm()
    clock.advance(10.0)
    assert state(drone) is FlightState.FLYING


def state(drone: FakeDrone) -> FlightState:
    (reading,) = drone.read(0.1)
    return reading.flight


def position(drone: FakeDrone) -> list[float]:
    (reading,) = drone.read(0.1)
    return [float(value) for value in reading.T_world_body[:3, 3]]


def test_a_drone_takes_off_when_armed_flies_and_lands(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    assert state(fake_drone) is FlightState.GROUND
    with pytest.raises(NotEnabledError, match="it first"):
        fake_drone.go_to((1.0, 1.0, 1.5), 0.0)
    fake_drone.arm()
    assert state(fake_drone) is FlightState.TAKING_OFF
    manual_clock.advance(1.0)
    assert position(fake_drone) == pytest.approx([2.5, 1.5, 0.5])
    manual_clock.advance(1.0)
    assert state(fake_drone) is FlightState.FLYING
    fake_drone.go_to((4.0, 1.5, 1.0), math.pi / 2)
    manual_clock.advance(1.0)
    assert position(fake_drone) == pytest.approx([3.0, 1.5, 1.0])
    (reading,) = fake_drone.read(0.1)
    np.testing.assert_allclose(reading.T_world_body[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.diag(reading.covariance)[:3], fake_drone.spec.position_sigma_m**2)
    fake_drone.land()
    assert state(fake_drone) is FlightState.LANDING
    manual_clock.advance(2.0)
    assert state(fake_drone) is FlightState.GROUND


def test_a_stopped_drone_holds_where_it_is_until_resumed(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    fly(fake_drone, manual_clock)
    fake_drone.go_to((4.5, 1.5, 1.0), 0.0)
    manual_clock.advance(1.0)
    fake_drone.stop()
    here = position(fake_drone)
    manual_clock.advance(10.0)
    assert position(fake_drone) == here
    assert state(fake_drone) is FlightState.FLYING
    with pytest.raises(NotEnabledError):
        fake_drone.go_to((1.0, 1.0, 1.5), 0.0)
    fake_drone.resume()
    fake_drone.go_to((1.0, 1.0, 1.5), 0.0)


def test_a_drone_refuses_what_is_outside_its_box(fake_drone: FakeDrone, manual_clock: ManualClock) -> None:
    fly(fake_drone, manual_clock)
    with pytest.raises(InputError, match="outside its box"):
        fake_drone.go_to((1.0, 1.0, 0.9), 0.0)
    assert fake_drone.commands == []


def test_an_unplugged_drone_is_lost(fake_drone: FakeDrone) -> None:
    fake_drone.faults.unplug()
    with pytest.raises(LinkLost):
        fake_drone.read(0.1)
    fake_drone.stop()


# --- camera ---------------------------------------------------------------------------------------------------


def test_pushed_frames_come_in_order_with_their_stamps_until_the_end(manual_clock: ManualClock) -> None:
    camera = FakeCamera("c", clock=manual_clock)
    camera.open()
    camera.push(GREY, stamp_s=1.0)
    camera.push(GREY, stamp_s=1.5)
    camera.end()
    frames = [camera.read(0.0), camera.read(0.0)]
    assert [(frame.stamp_s, frame.sequence) for frame in frames if frame] == [(1.0, 1), (1.5, 2)]
    with pytest.raises(EndOfInput):
        camera.read(0.0)
    camera.close()


def test_a_drawn_camera_keeps_its_rate_and_skips_what_was_missed(manual_clock: ManualClock) -> None:
    camera = FakeCamera("c", lambda stamp_s: np.full((2, 2), int(stamp_s * 10), np.uint8), fps=10.0, clock=manual_clock)
    camera.open()
    seen = []
    for _ in range(4):
        frame = camera.read(0.0)
        assert frame is not None
        seen.append((round(frame.stamp_s, 6), int(frame.image[0, 0]), frame.sequence))
        assert camera.read(0.0) is None
        manual_clock.advance(0.1001)
    manual_clock.advance(0.3)
    late = camera.read(0.0)
    assert seen == [(0.0, 0, 1), (0.1, 1, 2), (0.2, 2, 3), (0.3, 3, 4)]
    assert late is not None
    assert (round(late.stamp_s, 6), late.sequence) == (0.7, 8)


def test_a_blocked_read_is_woken() -> None:
    camera = FakeCamera("c")
    camera.open()
    results: list[object] = []
    reader = threading.Thread(target=lambda: results.append(camera.read(30.0)))
    start_s = time.monotonic()
    reader.start()
    camera.wake()
    reader.join(5.0)
    assert results == [None]
    assert time.monotonic() - start_s < 5.0


def test_an_unplugged_camera_is_lost_even_while_it_is_read() -> None:
    camera = FakeCamera("c")
    camera.open()
    timer = threading.Timer(0.02, camera.faults.unplug)
    timer.start()
    with pytest.raises(LinkLost):
        camera.read(30.0)
    timer.join()


def test_dropped_and_frozen_frames() -> None:
    camera = FakeCamera("c")
    camera.open()
    camera.faults.drop_next(1)
    camera.push(GREY)
    camera.push(GREY)
    first = camera.read(0.0)
    assert first is not None
    assert first.sequence == 2
    camera.faults.freeze = True
    camera.push(GREY + 1)
    again = camera.read(0.0)
    assert again is not None
    assert again.image is first.image


def test_drivers_build_what_their_sections_say(fake_head: FakeHead, fake_drone: FakeDrone) -> None:
    lens = BrownLens((32, 24), (30.0, 30.0), (16.0, 12.0))
    spec = CameraSpec("c", lens, FreeMount())
    camera = camera_driver.make({"c": (spec, camera_driver.section(fps=5.0, grey=9))})["c"]
    camera.open()
    frame = camera.read(1.0)
    assert frame is not None
    assert frame.image.shape == (24, 32)
    assert frame.image.mean() == 9.0
    head = head_driver.make({"h": (fake_head.spec, head_driver.section())})["h"]
    head.open()
    assert len(head.read(1.0)) == 2
    head.close()
    drone = drone_driver.make({"d": (fake_drone.spec, drone_driver.section())})["d"]
    drone.open()
    assert len(drone.read(1.0)) == 1
    drone.close()
