"""Stamps and poses from messages that arrive late, jittered and apart."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_drivers.mavlink.boot_clock import BootClock
from camrig_drivers.mavlink.frames import LocalFrame, R_world_body
from camrig_drivers.mavlink.packets import Attitude, LocalPosition
from camrig_drivers.mavlink.poses import PoseTrack, StampedPose

BOOTED_S = 1000.0
ORIGIN_M = (0.5, 0.0, 0.0)


def boot_ms(boot_s: float) -> int:
    return round(boot_s * 1e3)


def test_stamp_is_the_boot_time_plus_the_shortest_delay() -> None:
    """Delays of 2 ms and up, median 12 ms: after a second the stamps are at most 3 ms late, and half a ms rounded."""
    rng, clock = random.Random(1), BootClock()
    errors_s = []
    for count in range(600):
        boot_s = 20.0 + count / 60.0
        clock.update(boot_ms(boot_s), BOOTED_S + boot_s + 0.002 + rng.expovariate(math.log(2.0) / 0.010))
        errors_s.append(clock.stamp_s(boot_s) - (BOOTED_S + boot_s))
    settled_s = errors_s[60:]
    assert min(settled_s) >= 0.0015
    assert max(settled_s) <= 0.0035


def test_stamps_follow_a_clock_that_runs_slow() -> None:
    """200 ppm over a minute are 12 ms; the window forgets."""
    clock = BootClock()
    for count in range(3600):
        arrival_s = BOOTED_S + count / 60.0
        boot_s = (arrival_s - BOOTED_S) * (1.0 - 200e-6)
        clock.update(boot_ms(boot_s), arrival_s)
    assert clock.stamp_s(boot_s) == pytest.approx(arrival_s, abs=0.0016)


def test_timesync_takes_the_delay_out_of_the_stamps() -> None:
    """Telemetry is 30 ms old and more, answers need 4 ms at best: half of what a round trip hides remains."""
    rng, clock = random.Random(2), BootClock()
    for count in range(300):
        boot_s = 20.0 + count / 30.0
        clock.update(boot_ms(boot_s), BOOTED_S + boot_s + 0.030 + rng.expovariate(1 / 0.010))
        if count % 30 == 0:
            asked_s, there_s = BOOTED_S + boot_s, 0.002 + rng.expovariate(1 / 0.003)
            clock.synchronise(asked_s, boot_s + there_s, asked_s + there_s + 0.002)
    assert clock.synchronised
    assert clock.stamp_s(boot_s) == pytest.approx(BOOTED_S + boot_s, abs=0.002)


def test_timesync_of_a_clock_with_another_epoch_is_not_believed() -> None:
    clock = BootClock()
    clock.update(20_000, BOOTED_S + 20.005)
    clock.synchronise(BOOTED_S + 20.0, 1.7e9, BOOTED_S + 20.004)
    assert not clock.synchronised
    assert clock.stamp_s(20.0) == pytest.approx(BOOTED_S + 20.005)


def test_clock_that_falls_back_is_a_reboot() -> None:
    clock = BootClock()
    assert clock.update(100_000, 1100.0) == (100.0, False)
    assert clock.update(99_980, 1100.01) == (99.98, False)  # overtaken by another datagram
    clock.synchronise(1100.0, 100.0, 1100.002)
    assert clock.update(1_500, 1103.0) == (1.5, True)
    assert clock.stamp_s(1.5) == 1103.0


@given(st.integers(1, 3000), st.lists(st.integers(1, 1500), min_size=1, max_size=40))
def test_wrap_after_49_days_is_no_reboot(before_ms: int, steps_ms: list[int]) -> None:
    """The 32 bits of ``time_boot_ms`` run over; time goes on, whatever is lost around it."""
    clock, elapsed_ms = BootClock(), -before_ms
    start_s, _ = clock.update(elapsed_ms % 2**32, 5000.0 + elapsed_ms / 1e3)
    for step_ms in steps_ms:
        elapsed_ms += step_ms
        boot_s, rebooted = clock.update(elapsed_ms % 2**32, 5000.0 + elapsed_ms / 1e3)
        assert not rebooted
        assert boot_s - start_s == pytest.approx((elapsed_ms + before_ms) / 1e3, abs=1e-3)
    late_s, rebooted = clock.update((elapsed_ms - 20) % 2**32, 5000.0 + elapsed_ms / 1e3)
    assert not rebooted
    assert late_s == pytest.approx(boot_s - 0.02, abs=1e-3)


def position(boot_ms: int, north_m: float = 0.0) -> LocalPosition:
    return LocalPosition(boot_ms, (north_m, 2.0, -3.0))


def attitude(boot_ms: int, roll_rad: float = 0.0) -> Attitude:
    return Attitude(boot_ms, roll_rad, 0.0, math.pi / 2.0)


def hear(track: PoseTrack, *packets: Attitude | LocalPosition) -> list[StampedPose]:
    found: list[StampedPose] = []
    for packet in packets:
        poses, _ = track.hear(packet, BOOTED_S + packet.time_boot_ms / 1e3)
        found += poses
    return found


def test_attitude_is_interpolated_to_the_stamp_of_the_position() -> None:
    poses = hear(PoseTrack(LocalFrame(ORIGIN_M)), attitude(1000, 0.10), position(1010, 1.0), attitude(1040, 0.14))
    assert [pose.stamp_s for pose in poses] == [pytest.approx(BOOTED_S + 1.010)]
    assert poses[0].T_world_body[:3, 3] == pytest.approx(np.array([2.5, 1.0, 3.0]))
    assert poses[0].T_world_body[:3, :3] == pytest.approx(R_world_body(0.11, 0.0, math.pi / 2.0))


def test_attitude_of_the_same_instant_completes_at_once() -> None:
    assert len(hear(PoseTrack(LocalFrame(ORIGIN_M)), attitude(1000), position(1000))) == 1
    assert len(hear(PoseTrack(LocalFrame(ORIGIN_M)), position(1000), attitude(1000))) == 1


def test_position_that_comes_after_newer_attitudes_still_finds_its_own() -> None:
    poses = hear(
        PoseTrack(LocalFrame(ORIGIN_M)), attitude(1000, 0.0), attitude(1010, 0.1), attitude(1020, 0.5), position(1005)
    )
    assert poses[0].T_world_body[:3, :3] == pytest.approx(R_world_body(0.05, 0.0, math.pi / 2.0))


@pytest.mark.parametrize(
    "packets",
    [
        (position(1000), attitude(1010)),  # nothing before it
        (attitude(1000), position(1010)),  # nothing after it yet
        (attitude(1000), position(1150), attitude(1300)),  # too far apart
    ],
)
def test_no_pose_without_attitudes_close_on_both_sides(packets: tuple[Attitude | LocalPosition, ...]) -> None:
    assert hear(PoseTrack(LocalFrame(ORIGIN_M)), *packets) == []


def test_reboot_forgets_what_was_waiting() -> None:
    track = PoseTrack(LocalFrame(ORIGIN_M))
    hear(track, attitude(90_000), position(90_010))
    poses, rebooted = track.hear(attitude(500), 1100.0)
    assert rebooted
    assert poses == []
    poses, rebooted = track.hear(position(500), 1100.0)
    assert [pose.stamp_s for pose in poses] == [1100.0]
    assert not rebooted


def test_stamps_ascend_whatever_is_repeated_or_overtaken() -> None:
    track = PoseTrack(LocalFrame(ORIGIN_M))
    poses = hear(track, position(1000), attitude(1000), position(1000))
    poses += hear(track, attitude(1040), position(1040), position(1020))
    assert [pose.stamp_s - BOOTED_S for pose in poses] == pytest.approx([1.0, 1.04])


def test_stamps_ascend_while_the_first_delay_is_found_to_be_long() -> None:
    track, stamps_s = PoseTrack(LocalFrame(ORIGIN_M)), []
    for count, delay_s in enumerate([0.2, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002]):
        boot_ms = 1000 + 40 * count
        track.hear(attitude(boot_ms), BOOTED_S + boot_ms / 1e3 + delay_s)
        poses, _ = track.hear(position(boot_ms), BOOTED_S + boot_ms / 1e3 + delay_s)
        stamps_s += [pose.stamp_s for pose in poses]
    assert stamps_s == sorted(set(stamps_s))
    assert stamps_s[-1] == pytest.approx(BOOTED_S + 1.322)
