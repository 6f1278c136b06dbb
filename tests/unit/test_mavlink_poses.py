"""Stamps and poses from messages that arrive late, jittered and apart."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from camrig_drivers.mavlink.boot_clock import BootClock
from camrig_drivers.mavlink.frames import R_world_body
from camrig_drivers.mavlink.packets import Attitude, LocalPosition
from camrig_drivers.mavlink.poses import PoseTrack, StampedPose

BOOTED_S = 1000.0
ORIGIN_M = (0.5, 0.0, 0.0)


def test_stamp_is_the_boot_time_plus_the_shortest_delay() -> None:
    """Delays of 2 ms and up, median 12 ms: after a second the stamps are at most 3 ms late, never early."""
    rng, clock = random.Random(1), BootClock()
    errors_s = []
    for count in range(600):
        boot_s = 20.0 + count / 60.0
        clock.update(boot_s, BOOTED_S + boot_s + 0.002 + rng.expovariate(math.log(2.0) / 0.010))
        errors_s.append(clock.stamp_s(boot_s) - (BOOTED_S + boot_s))
    settled_s = errors_s[60:]
    assert min(settled_s) >= 0.002
    assert max(settled_s) <= 0.003


def test_stamps_follow_a_clock_that_runs_slow() -> None:
    """200 ppm over a minute are 12 ms; the window forgets."""
    clock = BootClock()
    for count in range(3600):
        arrival_s = BOOTED_S + count / 60.0
        boot_s = (arrival_s - BOOTED_S) * (1.0 - 200e-6)
        clock.update(boot_s, arrival_s)
    assert clock.stamp_s(boot_s) == pytest.approx(arrival_s, abs=0.0011)


def test_clock_that_falls_back_is_a_reboot() -> None:
    clock = BootClock()
    assert not clock.update(100.0, 1100.0)
    assert not clock.update(99.98, 1100.01)  # overtaken by another datagram
    assert clock.update(1.5, 1103.0)
    assert clock.stamp_s(1.5) == 1103.0


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
    poses = hear(PoseTrack(ORIGIN_M), attitude(1000, 0.10), position(1010, 1.0), attitude(1040, 0.14))
    assert [pose.stamp_s for pose in poses] == [pytest.approx(BOOTED_S + 1.010)]
    assert poses[0].T_world_body[:3, 3] == pytest.approx(np.array([2.5, 1.0, 3.0]))
    assert poses[0].T_world_body[:3, :3] == pytest.approx(R_world_body(0.11, 0.0, math.pi / 2.0))


def test_attitude_of_the_same_instant_completes_at_once() -> None:
    assert len(hear(PoseTrack(ORIGIN_M), attitude(1000), position(1000))) == 1
    assert len(hear(PoseTrack(ORIGIN_M), position(1000), attitude(1000))) == 1


def test_position_that_comes_after_newer_attitudes_still_finds_its_own() -> None:
    poses = hear(PoseTrack(ORIGIN_M), attitude(1000, 0.0), attitude(1010, 0.1), attitude(1020, 0.5), position(1005))
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
    assert hear(PoseTrack(ORIGIN_M), *packets) == []


def test_reboot_forgets_what_was_waiting() -> None:
    track = PoseTrack(ORIGIN_M)
    hear(track, attitude(90_000), position(90_010))
    poses, rebooted = track.hear(attitude(500), 1100.0)
    assert rebooted
    assert poses == []
    poses, rebooted = track.hear(position(500), 1100.0)
    assert [pose.stamp_s for pose in poses] == [1100.0]
    assert not rebooted


def test_stamps_ascend_whatever_is_repeated_or_overtaken() -> None:
    track = PoseTrack(ORIGIN_M)
    poses = hear(track, position(1000), attitude(1000), position(1000))
    poses += hear(track, attitude(1040), position(1040), position(1020))
    assert [pose.stamp_s - BOOTED_S for pose in poses] == pytest.approx([1.0, 1.04])


def test_stamps_ascend_while_the_first_delay_is_found_to_be_long() -> None:
    track, stamps_s = PoseTrack(ORIGIN_M), []
    for count, delay_s in enumerate([0.2, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002]):
        boot_ms = 1000 + 40 * count
        track.hear(attitude(boot_ms), BOOTED_S + boot_ms / 1e3 + delay_s)
        poses, _ = track.hear(position(boot_ms), BOOTED_S + boot_ms / 1e3 + delay_s)
        stamps_s += [pose.stamp_s for pose in poses]
    assert stamps_s == sorted(set(stamps_s))
    assert stamps_s[-1] == pytest.approx(BOOTED_S + 1.322)
