"""The emulated drone's body: limits, tilt, noise, truth and what telemetry says of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camrig.clock import ManualClock
from camrig_emulators.mavlink.dynamics import Airframe, Demand
from camrig_emulators.mavlink.frames import R_ned_frd, euler, quaternion, swap_yaw
from camrig_emulators.mavlink.noise import ColouredNoise
from camrig_emulators.mavlink_drone import MavlinkDrone, MavlinkDroneSettings
from tests.drone_pilot import SET_INTERVAL, START_S, Pilot, set_point

CALM: dict[str, Any] = {"hover_noise_m": 0.0, "estimate_noise_m": 0.0, "estimate_noise_deg": 0.0}
PLACE = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.5, 3))


def airframe(**changes: Any) -> Airframe:
    return Airframe(MavlinkDroneSettings.model_validate(changes), np.random.default_rng(0))


@settings(max_examples=15, deadline=None)
@given(places=st.lists(PLACE, min_size=1, max_size=3), yaw_rad=st.floats(-3, 3))
def test_it_keeps_its_limits_and_arrives(places: list[tuple[float, float, float]], yaw_rad: float) -> None:
    body = airframe(**CALM)
    turned_rad = body.truth.yaw_rad
    for place in places:
        demand = Demand(position_m=np.array(place), yaw_rad=yaw_rad)
        for _ in range(800):
            body.advance(0.01, demand)
            truth = body.truth
            assert np.linalg.norm(truth.acceleration_m_s2[:2]) <= 2.5 + 1e-9
            assert abs(truth.acceleration_m_s2[2]) <= 2.5 + 1e-9
            assert np.linalg.norm(truth.velocity_m_s[:2]) <= 2.0 * 1.05
            assert abs(truth.velocity_m_s[2]) <= 1.0 * 1.05
            assert abs(truth.yaw_rad - turned_rad) <= math.radians(90.0) * 0.01 + 1e-9
            turned_rad = truth.yaw_rad
        assert body.truth.position_m == pytest.approx(np.array(place), abs=0.01)
    assert math.remainder(body.truth.yaw_rad - yaw_rad, math.tau) == pytest.approx(0.0, abs=0.01)


def test_it_leans_into_its_acceleration() -> None:
    """Nose east: speeding up eastward lowers the nose, and NED pitch is negative; northward it leans to the left."""
    for direction, index, sign in (((1.0, 0.0), 1, -1.0), ((0.0, 1.0), 0, -1.0)):
        body = airframe(**CALM)
        target = np.array([10.0 * direction[0], 10.0 * direction[1], 2.0])
        for _ in range(60):
            body.advance(0.01, Demand(position_m=target, yaw_rad=0.0))
        attitude = euler(R_ned_frd(body.truth.T_world_body()[:3, :3]))
        up = body.truth.acceleration_m_s2 + np.array([0.0, 0.0, 9.81])
        lean_rad = math.atan2(float(np.hypot(up[0], up[1])), up[2])
        assert attitude[index] == pytest.approx(sign * lean_rad, abs=1e-6)
        assert attitude[1 - index] == pytest.approx(0.0, abs=1e-6)
        assert attitude[2] == pytest.approx(math.pi / 2.0, abs=1e-6)
        assert lean_rad > math.radians(8.0)


def test_the_quaternion_is_the_euler_angles() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        axis_angle = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) * rng.normal(size=(3, 3))
        R = np.linalg.qr(axis_angle)[0]
        R = R * np.sign(np.linalg.det(R))
        w, x, y, z = quaternion(R)
        again = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        assert again == pytest.approx(R, abs=1e-9)


def test_yaw_swaps_both_ways() -> None:
    assert swap_yaw(0.0) == pytest.approx(math.pi / 2.0)  # nose east
    assert swap_yaw(math.pi / 2.0) == pytest.approx(0.0)  # nose north
    assert swap_yaw(swap_yaw(2.5)) == pytest.approx(2.5)


def test_noise_has_the_sigma_the_rate_and_the_acceleration_it_says() -> None:
    tau_s = 0.5
    noise = ColouredNoise(np.full(500, 2.0), np.full(500, tau_s), np.random.default_rng(7))
    values = []
    for _ in range(200):
        before = noise.value
        for _ in range(10):
            noise.advance(0.01)
        values.append((noise.value.std(), noise.rate.std(), noise.acceleration.std()))
        assert np.corrcoef(before, noise.value)[0, 1] > 0.95
    sigma, rate, acceleration = np.mean(values, axis=0)
    assert sigma == pytest.approx(2.0, rel=0.05)
    assert rate == pytest.approx(2.0 / (math.sqrt(3.0) * tau_s), rel=0.05)
    assert acceleration == pytest.approx(2.0 / tau_s**2, rel=0.05)


def flown(seed: int, flavour: str, **changes: Any) -> Pilot:
    pilot = Pilot(flavour, seed=seed, **changes)
    pilot.take_off()
    for number in (30, 31, 32):
        pilot.command(SET_INTERVAL, number, 1e6 / 25.0)
    pilot.heard.clear()
    return pilot


@pytest.mark.parametrize(("flavour", "latency_s"), [("ardupilot", 0.0), ("px4", 0.05)])
def test_telemetry_tells_the_truth_at_its_stamp_but_for_its_noise(flavour: str, latency_s: float) -> None:
    pilot = flown(3, flavour, telemetry_latency_s=latency_s)
    history, boot_s, errors_m, errors_rad, ages_s = pilot.vehicle.history, pilot.vehicle.boot_s, [], [], []
    for target in ((2.0, 1.0, -2.0), (-1.0, 2.0, -1.5), (0.0, -2.0, -2.5)) * 2:
        pilot.heard.clear()
        pilot.wait(5.0, set_point(target, yaw=target[0]))
        for heard_s, message in pilot.heard:
            if message.get_type() == "LOCAL_POSITION_NED":
                truth = history.truth(boot_s + message.time_boot_ms / 1e3)
                x, y, z = truth.position_m
                errors_m.append(np.array([message.x - y, message.y - x, message.z + z]))
                ages_s.append(heard_s - boot_s - message.time_boot_ms / 1e3)
            elif message.get_type() == "ATTITUDE":
                R = R_ned_frd(history.truth(boot_s + message.time_boot_ms / 1e3).T_world_body()[:3, :3])
                expected = np.array(euler(R))
                turn = np.array([message.roll, message.pitch, message.yaw]) - expected
                errors_rad.append(np.remainder(turn + math.pi, math.tau) - math.pi)
    assert len(errors_m) > 600
    assert np.std(errors_m) == pytest.approx(0.01, rel=0.35)
    assert np.degrees(np.std(errors_rad)) == pytest.approx(0.1, rel=0.5)
    assert np.median(ages_s) == pytest.approx(latency_s, abs=0.011)


def test_without_noise_telemetry_is_the_truth() -> None:
    pilot = flown(3, "ardupilot", **CALM)
    pilot.wait(4.0, set_point((2.0, 1.0, -2.0), yaw=1.0))
    history, boot_s = pilot.vehicle.history, pilot.vehicle.boot_s
    for message in pilot.since(0.0, "LOCAL_POSITION_NED"):
        x, y, z = history.truth(boot_s + message.time_boot_ms / 1e3).position_m
        assert (message.x, message.y, message.z) == pytest.approx((y, x, -z), abs=1e-6)
    for message in pilot.since(0.0, "ATTITUDE_QUATERNION"):
        R = R_ned_frd(history.truth(boot_s + message.time_boot_ms / 1e3).T_world_body()[:3, :3])
        assert (message.q1, message.q2, message.q3, message.q4) == pytest.approx(quaternion(R), abs=1e-6)


def test_it_hovers_with_the_noise_it_says() -> None:
    pilot = flown(5, "ardupilot", estimate_noise_m=0.0)
    pilot.wait(3.0)
    places = []
    for _ in range(700):
        pilot.wait(0.1)
        places.append(pilot.ned)
    assert np.std(places, axis=0) == pytest.approx(np.full(3, 0.01), rel=0.3)


def test_the_same_seed_gives_the_same_flight() -> None:
    def flight(seed: int) -> list[np.ndarray[Any, np.dtype[np.float64]]]:
        pilot = flown(seed, "px4")
        places = []
        for _ in range(20):
            pilot.wait(0.1, set_point((1.0, 0.0, -2.0)))
            places.append(pilot.ned)
        return places

    assert np.array_equal(flight(1), flight(1))
    assert not np.array_equal(flight(1), flight(2))


def test_truth_is_settled_once_told_and_bounded() -> None:
    clock = ManualClock(START_S)
    drone = MavlinkDrone(MavlinkDroneSettings(start_position_m=(1.0, 2.0, 0.0), start_yaw_deg=90.0), clock=clock)
    clock.advance(0.0153)
    T = drone.T_world_body(START_S + 0.015)
    assert T[:3, 3] == pytest.approx([1.0, 2.0, 0.0])
    assert T[:3, 0] == pytest.approx([0.0, 1.0, 0.0])  # the nose
    assert np.array_equal(drone.T_world_body(START_S - 100.0), T)  # it stood there before, too
    clock.advance(30.0)
    drone.T_world_body(START_S + 29.0)
    with pytest.raises(ValueError, match="future"):
        drone.T_world_body(START_S + 31.0)
    with pytest.raises(ValueError, match="gone"):
        drone.T_world_body(START_S + 5.0)
    assert drone.describe().startswith("drone: ardupilot STABILIZE, disarmed, (1.00, 2.00, 0.00) m, yaw 90 deg")


def test_truth_between_steps_is_the_same_whenever_it_is_asked() -> None:
    early, late = (flown(1, "ardupilot") for _ in range(2))
    told = []
    for pilot, ask_at_once in ((early, True), (late, False)):
        pilot.say(set_point((2.0, 0.0, -2.0)))
        stamps = [pilot.now_s + 0.1 * i + 0.0037 for i in range(10)]
        if ask_at_once:
            for stamp_s in stamps:
                pilot.vehicle.advance_to(stamp_s)
                told.append(pilot.vehicle.T_world_body(stamp_s))
        pilot.wait(2.0)
        told.append(np.array([pilot.vehicle.T_world_body(stamp_s) for stamp_s in stamps]))
    assert np.array_equal(told[:10], told[10])
    assert np.array_equal(told[10], told[11])
