"""The driver's bytes on UDP against a peer that says exactly what the test tells it to."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import threading
import time
from typing import Any

import pytest
from pydantic import ValidationError

from camrig.errors import HardwareError, LinkLost
from camrig.messages import FlightState
from camrig_drivers.mavlink import MavlinkDrone, MavlinkSection, driver
from camrig_drivers.udp import UdpSocket
from tests.mavlink_peer import (
    ARDUPILOT,
    NOT_AN_AUTOPILOT,
    PX4,
    SPEC,
    LeapClock,
    Peer,
    found,
    free_port,
    heartbeat,
    listening,
    make_drone,
    opened,
    sending,
    served,
    telemetry,
    url_of,
)

# --- opening --------------------------------------------------------------------------------------------


def test_opening_says_who_we_are_and_asks() -> None:
    with listening() as peer, opened(make_drone(url_of(peer), stream_hz=20.0), peer) as drone:
        greeting = drone.read(0.0)
        messages = peer.heard()
    assert greeting == ()
    assert {message.get_srcSystem() for message in messages} == {255}
    assert {message.get_srcComponent() for message in messages} == {190}
    intervals = {m.param1: m.param2 for m in messages if m.get_type() == "COMMAND_LONG"}
    assert intervals == {30.0: 50_000.0, 32.0: 50_000.0, 245.0: 200_000.0, 1.0: 500_000.0, 193.0: 200_000.0, 148.0: 0.0}
    commands = [m for m in messages if m.get_type() == "COMMAND_LONG"]
    assert {(m.command, m.target_system, m.target_component) for m in commands} == {(511, 1, 1), (512, 1, 1)}
    asked = {m.param_id for m in messages if m.get_type() == "PARAM_REQUEST_READ"}
    assert {"FS_GCS_ENABLE", "GUID_TIMEOUT", "MAV_GCS_SYSID", "SYSID_MYGCS"} <= asked
    assert "TIMESYNC" in {message.get_type() for message in messages}


def test_first_word_is_a_ground_station_heartbeat() -> None:
    with listening() as peer:
        drone = make_drone(url_of(peer))
        opener = threading.Thread(target=drone.open)
        opener.start()
        first = peer.heard(0.1)
        peer.say(heartbeat())
        opener.join()
        drone.close()
    assert [(m.get_type(), m.type, m.autopilot) for m in first] == [("HEARTBEAT", 6, 8)]


def test_heartbeat_goes_out_every_second() -> None:
    clock = LeapClock()
    with listening() as peer, opened(make_drone(url_of(peer), clock), peer) as drone:
        peer.heard()
        for _ in range(4):
            clock.ahead_s += 1.0
            peer.say(heartbeat())
            served(drone, 0.05)
        beats = [m for m in peer.heard() if m.get_type() == "HEARTBEAT"]
    assert len(beats) == 4


def test_no_heartbeat_names_who_else_is_there() -> None:
    clock = LeapClock()
    port = free_port()
    drone = make_drone(f"udp://127.0.0.1:{port}", clock)
    with sending(port, system=7) as stranger:

        def chatter() -> None:
            for _ in range(3):
                time.sleep(0.05)
                with contextlib.suppress(OSError):  # the driver's port may not be open yet
                    stranger.say(heartbeat())
            clock.ahead_s += 10.0

        thread = threading.Thread(target=chatter)
        thread.start()
        with pytest.raises(LinkLost, match=r"system 1 component 1 .* others? .*7 component 1|autopilots heard: 7"):
            drone.open()
        thread.join()
    drone.close()


def test_autopilot_that_we_cannot_fly_is_refused() -> None:
    with (
        listening() as peer,
        pytest.raises(HardwareError, match="autopilot type 0"),
        opened(make_drone(url_of(peer)), peer, heartbeat(autopilot=0)),
    ):
        pass


def test_an_aeroplane_or_a_rover_of_the_same_firmware_is_refused() -> None:
    """ArduPlane's mode 4 is ACRO, a rover's is HOLD."""
    for kind in (1, 10):
        with (
            listening() as peer,
            pytest.raises(HardwareError, match=f"system 1 is a vehicle of MAV_TYPE {kind}; multicopters"),
            opened(make_drone(url_of(peer)), peer, heartbeat(kind=kind)),
        ):
            pass


def test_heartbeats_of_ground_stations_and_cameras_are_not_the_vehicle() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer, heartbeat(NOT_AN_AUTOPILOT), heartbeat()) as drone:
        peer.say(heartbeat(NOT_AN_AUTOPILOT, mode=99))
        served(drone)


def test_nobody_at_the_port_is_a_lost_link() -> None:
    drone = make_drone(f"udpout://127.0.0.1:{free_port()}")
    with pytest.raises(LinkLost, match="refused"):
        drone.open()
    drone.close()


def test_port_that_is_taken_is_a_lost_link() -> None:
    with listening() as peer:
        drone = make_drone(url_of(peer).replace("udpout", "udp"))
        with pytest.raises(LinkLost, match="in use"):
            drone.open()
        drone.close()


# --- reading --------------------------------------------------------------------------------------------


def test_readings_are_stamped_by_our_clock_in_world_axes() -> None:
    with listening() as peer, opened(make_drone(url_of(peer), origin_m=(0.5, 0.0, 0.0)), peer) as drone:
        peer.say(*telemetry(5000))
        sent_s = time.monotonic()
        (reading,) = drone.read(0.5)
    assert abs(reading.stamp_s - sent_s) < 0.05
    assert reading.T_world_body[:3, 3] == pytest.approx([1.5, 2.0, 0.0])
    assert reading.T_world_body[:3, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)  # NED yaw 0 = nose north = world y
    assert reading.covariance.diagonal() == pytest.approx([1e-4] * 3 + [2.5e-5] * 3)
    assert reading.flight is FlightState.GROUND


def test_garbage_before_a_message_does_not_cost_it() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        assert peer.driver_address is not None
        peer.socket.sendto(b"\xfd\x09\x00noise", peer.driver_address)
        peer.say(*telemetry(5000))
        assert len(drone.read(0.5)) == 1


def test_three_seconds_without_heartbeat_is_a_lost_link() -> None:
    clock = LeapClock()
    with listening() as peer, opened(make_drone(url_of(peer), clock), peer) as drone:
        clock.ahead_s += 2.9
        drone.read(0.0)
        clock.ahead_s += 0.2
        with pytest.raises(LinkLost, match="no heartbeat for 3 s"):
            drone.read(0.0)


def test_router_that_restarts_costs_nobody_his_flight_and_one_that_stays_away_is_a_lost_link() -> None:
    """Its port is closed for a moment, and the kernel tells so at every word."""
    clock = LeapClock()
    with listening() as peer, opened(make_drone(url_of(peer), clock), peer) as drone:
        port = peer.socket.getsockname()[1]
        before = drone.health()
        peer.heard(0.05)
        peer.socket.close()
        clock.ahead_s += 1.0  # the next heartbeat meets a closed port
        served(drone, 0.3)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
            again.bind(("127.0.0.1", port))
            restarted = Peer(again)
            restarted.driver_address = peer.driver_address
            restarted.say(heartbeat(), *telemetry(500))
            assert len(drone.read(0.2)) == 1
            assert before is not None
        clock.ahead_s += 3.1
        with pytest.raises(LinkLost, match="no heartbeat"):
            served(drone, 0.5)


@pytest.mark.parametrize("number", [errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENOBUFS])
def test_a_network_that_is_down_for_a_moment_closes_no_port(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with sending(port := free_port()) as peer, found(make_drone(f"udp://127.0.0.1:{port}"), peer) as drone:

        def unreachable(self: UdpSocket, data: bytes, peer: tuple[str, int]) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(UdpSocket, "send", unreachable)
        drone.stop()
        served(drone, 0.2)
        monkeypatch.undo()
        peer.heard(0.01)
        peer.say(heartbeat(), *telemetry(700))
        assert len(drone.read(0.2)) == 1


def test_read_before_open_says_so() -> None:
    with pytest.raises(LinkLost, match="not open"):
        make_drone("udp://127.0.0.1:14550").read(0.0)


# --- who is who -----------------------------------------------------------------------------------------


def test_listening_driver_answers_where_the_vehicle_sends_from() -> None:
    port = free_port()
    with sending(port) as peer, found(make_drone(f"udp://127.0.0.1:{port}"), peer, PX4):
        types = [message.get_type() for message in peer.heard()]
    assert types.count("HEARTBEAT") == 1
    assert types.count("COMMAND_LONG") == 6  # five streams and the version


def test_second_vehicle_of_one_system_is_refused() -> None:
    port = free_port()
    drone = make_drone(f"udp://127.0.0.1:{port}")
    with sending(port) as peer, sending(port) as rival, found(drone, peer):
        for speaker in (peer, rival, peer):
            speaker.say(heartbeat())
        with pytest.raises(LinkLost, match="two autopilots speak as system 1"):
            served(drone)


@pytest.mark.parametrize("change", [{"component": 2}, {"autopilot": PX4}])
def test_second_autopilot_behind_one_address_is_refused(change: dict[str, int]) -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        second = Peer(peer.socket, component=change.get("component", 1))
        second.driver_address = peer.driver_address
        second.say(heartbeat(change.get("autopilot", ARDUPILOT)))
        with pytest.raises(LinkLost, match="two autopilots"):
            served(drone)
        with pytest.raises(HardwareError, match="two autopilots"):
            drone.arm()


def test_vehicle_that_restarts_on_another_port_is_found_again() -> None:
    clock, port = LeapClock(), free_port()
    drone = make_drone(f"udp://127.0.0.1:{port}", clock)
    with sending(port) as peer, sending(port) as restarted, found(drone, peer):
        drone.read(0.02)
        clock.ahead_s += 2.7
        restarted.say(heartbeat(), *telemetry(700))
        assert len(drone.read(0.2)) == 1
        assert restarted.heard()


def test_the_seat_of_a_drone_that_was_lost_in_the_air_passes_to_no_other_aircraft() -> None:
    clock, port = LeapClock(), free_port()
    drone = make_drone(f"udp://127.0.0.1:{port}", clock)
    in_the_air = (heartbeat(mode=4, armed=True), *telemetry(700, landed_state=2, height_m=1.5))
    with sending(port) as peer, sending(port) as other, found(drone, peer):
        peer.say(*in_the_air)
        drone.read(0.1)
        assert peer.heard()
        clock.ahead_s += 2.7
        other.say(heartbeat(), *telemetry(700))
        with pytest.raises(LinkLost, match="two autopilots speak as system 1"):
            served(drone, 0.2)
        drone.close()

        def speak(speaker: Peer) -> None:
            for _ in range(4):
                time.sleep(0.05)
                speaker.say(heartbeat())
            clock.ahead_s += 6.0

        for _ in range(2):  # nor is it forgotten by opening once
            thread = threading.Thread(target=speak, args=(other,))
            thread.start()
            with pytest.raises(LinkLost, match=r"was lost in flight, now one speaks at .*restart camrig"):
                drone.open()
            thread.join()
        assert not other.heard(0.05)
        peer.heard(0.01)
        with found(drone, peer):
            peer.say(*in_the_air)
            assert drone.read(0.2)


def test_a_drone_that_is_waited_for_keeps_no_other_from_its_orders() -> None:
    """Two of three drones on one port are not there; opening waits five seconds for each."""
    port = free_port()
    section = MavlinkSection(url=f"udp://127.0.0.1:{port}")
    sections = {name: section.model_copy(update={"system": i}) for i, name in enumerate("abc", 1)}
    drones = driver.make({name: (SPEC, own) for name, own in sections.items()})
    with sending(port) as peer, found(drones["a"], peer):
        peer.say(heartbeat(mode=4, armed=True), *telemetry(1000, landed_state=2, height_m=1.5))
        served(drones["a"])
        openers = [threading.Thread(target=_open_in_vain, args=(drones[name],)) for name in "bc"]
        for opener in openers:
            opener.start()
        time.sleep(0.2)
        peer.heard(0.01)
        started_s = time.monotonic()
        drones["a"].stop()
        stopped_s = time.monotonic() - started_s
        drones["a"].land()
        drones["a"].read(0.02)
        read_s = time.monotonic() - started_s
        assert 21 in [m.command for m in peer.heard(0.3) if m.get_type() == "COMMAND_LONG"]
        for opener in openers:
            opener.join()
    assert stopped_s < 0.1
    assert read_s < 1.0


def _open_in_vain(drone: MavlinkDrone) -> None:
    with pytest.raises(LinkLost, match="no heartbeat"):
        drone.open()


def test_two_drones_share_one_port_and_two_threads() -> None:
    port = free_port()
    url = f"udp://127.0.0.1:{port}"
    section = MavlinkSection(url=url)
    both = driver.make({"a": (SPEC, section), "b": (SPEC, section.model_copy(update={"system": 2}))})
    counts = {"a": 0, "b": 0}

    def work(name: str) -> None:
        both[name].open()
        end_s = time.monotonic() + 1.0
        while time.monotonic() < end_s:
            counts[name] += len(both[name].read(0.1))
        both[name].close()

    threads = [threading.Thread(target=work, args=(name,)) for name in both]
    for thread in threads:
        thread.start()
    with sending(port, system=1) as first, sending(port, system=2) as second:
        boot_ms = 1000
        while any(thread.is_alive() for thread in threads):
            time.sleep(0.02)
            boot_ms += 20
            for peer in (first, second):
                with contextlib.suppress(OSError):
                    peer.say(heartbeat(), *telemetry(boot_ms))
    assert min(counts.values()) >= 20


# --- the section ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"url": "tcp://127.0.0.1"}, "tcp://host:port"),
        ({"url": "serial:///dev/ttyUSB0"}, "serial:///dev/...:baud"),
        ({"url": "udp://127.0.0.1"}, "udp://host:port"),
        ({"url": "udp://127.0.0.1:99999"}, "udp://host:port"),
        ({"url": "/dev/ttyUSB0"}, "serial:///dev/...:baud"),
        ({"url": "udp://127.0.0.1:14550", "pose": "lidar"}, "'telemetry' or 'vision'"),
        ({"url": "udp://127.0.0.1:14550", "sytem": 2}, "Extra inputs"),
        ({"url": "udp://127.0.0.1:14550", "system": 255}, "less than or equal to 254"),
    ],
)
def test_section_refuses(keys: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        MavlinkSection(**keys)


def test_two_drones_on_one_url_need_two_systems() -> None:
    section = MavlinkSection(url="udp://127.0.0.1:14550")
    assert driver.check is not None
    faults = driver.check({"a": (SPEC, section), "b": (SPEC, section)})
    assert [(name, key) for name, key, _ in faults] == [("b", "system")]
    assert not driver.check({"a": (SPEC, section), "b": (SPEC, section.model_copy(update={"system": 2}))})
    emulated = MavlinkSection(url="emulated")
    assert not driver.check({"a": (SPEC, emulated), "b": (SPEC, emulated)})
