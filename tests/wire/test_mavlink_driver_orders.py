"""Orders become bytes on UDP: take-over, go_to, stop from any thread, close."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from camrig.clock import RealClock
from camrig.errors import InputError, NotEnabledError
from camrig.messages import BodyPose
from camrig_drivers.mavlink import MavlinkDrone, MavlinkSection
from camrig_drivers.mavlink.link import Link
from tests.mavlink_peer import (
    GUIDED,
    PX4,
    SPEC,
    Peer,
    heartbeat,
    listening,
    make_drone,
    opened,
    parameters,
    px4_parameters,
    served,
    telemetry,
    url_of,
)


def flying(peer: Peer, drone: MavlinkDrone) -> None:
    """Take over a vehicle that hovers in GUIDED already, and send it off to the east."""
    peer.say(*parameters())
    hover(peer, drone, 1000)
    drone.resume()
    served(drone)
    drone.go_to((4.0, 2.0, 1.5), 0.0)


def hover(peer: Peer, drone: MavlinkDrone, boot_ms: int) -> None:
    peer.say(heartbeat(mode=GUIDED, armed=True), *telemetry(boot_ms, landed_state=2, height_m=1.5))
    served(drone)


def set_points(messages: list[Any]) -> list[tuple[float, float, float]]:
    return [(m.x, m.y, m.z) for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def test_stop_from_another_thread_is_on_the_wire_at_once() -> None:
    """While the worker waits in ``read``; the bound is generous for a loaded machine."""
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        flying(peer, drone)
        for boot_ms in range(1100, 1600, 100):
            hover(peer, drone, boot_ms)
        before = set_points(peer.heard(0.01))
        worker = threading.Thread(target=served, args=(drone, 0.4))
        worker.start()
        started_s = time.monotonic()
        drone.stop()
        (first,) = set_points(peer.heard(0.02))[:1]
        latency_s = time.monotonic() - started_s
        with pytest.raises(NotEnabledError):
            drone.go_to((4.0, 2.0, 1.5), 0.0)
        worker.join()
        after = set_points(peer.heard(0.05))
    assert max(east_m for _, east_m, _ in before) > 1.1
    assert first == (2.0, 1.0, -1.5)
    assert set(after) == {first}
    assert latency_s < 0.15  # of which the test itself listens for 0.02 s of silence


def test_stop_without_a_fresh_position_holds_the_last_set_point() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        flying(peer, drone)
        served(drone, 0.7)  # after 0.5 s without a position it holds by itself
        moving = set_points(peer.heard(0.01))
        drone.stop()
        assert set_points(peer.heard(0.05)) == [moving[-1]]


def test_stop_needs_no_reader() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        flying(peer, drone)
        served(drone)
        peer.heard(0.01)
        drone.stop()
        assert "SET_POSITION_TARGET_LOCAL_NED" in [message.get_type() for message in peer.heard(0.05)]


def test_take_over_in_the_air_commands_the_present_place_only() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        peer.say(*parameters())
        peer.say(heartbeat(mode=GUIDED, armed=True), *telemetry(1000, landed_state=2, height_m=1.5))
        served(drone)
        peer.heard(0.01)
        drone.resume()
        served(drone, 0.3)
        sent = peer.heard(0.05)
    targets = [m for m in sent if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert {(m.coordinate_frame, m.type_mask, m.target_system) for m in targets} == {(1, 0x9F8, 1)}
    assert {(m.x, m.y, m.z) for m in targets} == {(2.0, 1.0, -1.5)}
    assert {m.command for m in sent if m.get_type() == "COMMAND_LONG"} <= {178, 511, 512}


def test_go_to_is_checked_before_anything_else() -> None:
    drone = make_drone("udp://127.0.0.1:14550")
    for place in [(-0.1, 1.0, 1.5), (1.0, 1.0, 0.9), (1.0, 1.0, float("nan"))]:
        with pytest.raises(InputError, match=r"outside its box \[0, 0, 1\] to \[5, 3, 2.5\] m"):
            drone.go_to(place, 0.0)
    for place in [(1.0, 1.0, 1.5), (5.0 + 1e-12, 3.0, 2.5)]:
        with pytest.raises(NotEnabledError, match="it first"):
            drone.go_to(place, 0.0)


def test_closing_twice_and_stopping_when_closed_are_allowed() -> None:
    drone = make_drone("udp://127.0.0.1:14550")
    drone.stop()
    drone.close()
    drone.close()


class Interrupted(Link):
    """A link on which a stop comes from another thread just before its worker's next word."""

    stop: Callable[[], None] | None = None

    def serve_now(self) -> None:
        stop, self.stop = self.stop, None
        if stop:
            stop()
        super().serve_now()


def test_a_stop_in_the_midst_of_closing_does_not_keep_px4_from_being_left_in_hold() -> None:
    with listening() as peer:
        link = Interrupted(url_of(peer), RealClock())
        drone = MavlinkDrone(SPEC, MavlinkSection(url=url_of(peer)), link)
        with opened(drone, peer, heartbeat(PX4)):
            peer.say(*px4_parameters())
            for boot_ms in range(1000, 2600, 100):
                in_offboard = heartbeat(PX4, 0x60000, armed=True)
                peer.say(in_offboard, *telemetry(boot_ms, landed_state=2, height_m=1.5))
                served(drone, 0.02)
                drone.resume()
                served(drone, 0.08)
            peer.heard(0.01)
            link.stop = drone.stop
            drone.close()
            sent = [m for m in peer.heard(0.05) if m.get_type() == "COMMAND_LONG"]
    assert (176, 4.0, 3.0) in [(m.command, m.param2, m.param3) for m in sent]


def test_a_pose_by_anchors_is_on_the_wire_in_milliseconds() -> None:
    """From the camera's thread, while the drone's waits; the median, for the machine is shared."""
    with listening() as peer, opened(make_drone(url_of(peer), pose="vision"), peer) as drone:
        peer.heard(0.01)
        peer.socket.settimeout(2.0)
        worker = threading.Thread(target=served, args=(drone, 1.5))
        worker.start()
        latencies_s = []
        for _ in range(15):
            now_s = time.monotonic()
            drone.take_pose(BodyPose("d1", now_s, np.eye(4), 1e-4 * np.eye(6)))
            while True:
                data = peer.socket.recv(2048)
                arrived_s = time.monotonic()
                if any(m.get_type() == "VISION_POSITION_ESTIMATE" for m in peer.parse(data)):
                    break
            latencies_s.append(arrived_s - now_s)
            time.sleep(0.03)
        worker.join()
    assert sorted(latencies_s)[len(latencies_s) // 2] < 0.005


def test_a_pose_by_anchors_ages_from_its_picture_not_from_its_sending() -> None:
    with listening() as peer, opened(make_drone(url_of(peer), pose="vision"), peer) as drone:
        drone.take_pose(BodyPose("d1", time.monotonic() - 0.4, np.eye(4), 1e-4 * np.eye(6)))
        served(drone, 0.2)
        assert "VISION_POSITION_ESTIMATE" in {m.get_type() for m in peer.heard(0.05)}
        health = drone.health()
    assert health is not None
    assert any("its camera sees no anchors" in reason for reason in health.unfit)


def test_a_drone_that_navigates_by_itself_is_sent_no_poses() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        drone.take_pose(BodyPose("d1", time.monotonic(), np.eye(4), 1e-4 * np.eye(6)))
        served(drone)
        assert not {"VISION_POSITION_ESTIMATE", "ODOMETRY"} & {m.get_type() for m in peer.heard(0.05)}
