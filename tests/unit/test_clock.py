"""The real clock is CLOCK_MONOTONIC; the manual one moves by hand alone and wakes who waits for it."""

from __future__ import annotations

import threading
import time

import pytest

from camrig.clock import ManualClock, RealClock


def test_the_real_clock_is_the_one_of_the_devices_stamps() -> None:
    before_s = time.clock_gettime(time.CLOCK_MONOTONIC)
    now_s = RealClock().now_s()
    assert before_s <= now_s <= time.clock_gettime(time.CLOCK_MONOTONIC)


@pytest.mark.parametrize(("duration_s", "at_least_s"), [(0.02, 0.02), (0.0, 0.0), (-1.0, 0.0)])
def test_a_sleep_takes_its_time_and_a_negative_one_none(duration_s: float, at_least_s: float) -> None:
    clock = RealClock()
    before_s = clock.now_s()
    clock.sleep_s(duration_s)
    assert clock.now_s() - before_s >= at_least_s


def test_a_manual_clock_stands_until_it_is_moved() -> None:
    clock = ManualClock(start_s=7.0)
    time.sleep(0.005)
    assert clock.now_s() == 7.0
    clock.advance(0.5)
    assert clock.now_s() == 7.5


def test_a_manual_clock_is_not_moved_back() -> None:
    clock = ManualClock(1.0)
    with pytest.raises(ValueError, match="never moved back"):
        clock.advance(-0.1)
    assert clock.now_s() == 1.0


def test_a_sleeper_wakes_when_its_time_has_come_and_no_sooner() -> None:
    clock = ManualClock()
    spans_s: list[float] = []

    def sleep() -> None:
        began_s = clock.now_s()
        clock.sleep_s(1.0)
        spans_s.append(clock.now_s() - began_s)

    clock.sleep_s(0.0)
    sleeper = threading.Thread(target=sleep)
    sleeper.start()
    while sleeper.is_alive():
        clock.advance(0.25)
        sleeper.join(0.001)
    assert spans_s[0] >= 1.0
