"""TCP, serial lines and signatures: what the driver says and hears on each, and what it does when a link ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import socket
import struct
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig.clock import RealClock
from camrig.errors import InputError, LinkLost
from camrig_drivers.mavlink import MavlinkDrone, MavlinkSection, driver
from camrig_drivers.mavlink.codec import Decoder, Encoder, Seals
from camrig_drivers.mavlink.link import Link
from camrig_drivers.mavlink.packets import Heartbeat, OwnHeartbeat, PositionTarget, TimeSync
from camrig_drivers.mavlink.section import SigningSection
from camrig_drivers.mavlink.signing import Signing, read_key
from camrig_drivers.mavlink.wire import SerialWire, TcpWire
from tests.mavlink_peer import (
    SPEC,
    LeapClock,
    heartbeat,
    listening,
    make_drone,
    opened,
    parameters,
    served,
    telemetry,
    url_of,
)
from tests.runtime_parts import until

KEY = bytes(range(32))
PEER = ("", 0)
NOON_S = 1_800_000_000.0


class Stream:
    """The vehicle's end of a stream of bytes; it greets whoever speaks, and hears what is said."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self.heard: list[Any] = []
        self.mavlink = dialect.MAVLink(None, 1, 1)
        self.mavlink.robust_parsing = True
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self.fd, 4096):
                self.heard += self.mavlink.parse_buffer(bytearray(data)) or []
                for message in (heartbeat(), *telemetry(round(time.monotonic() * 1e3) & 0xFFFFFFFF)):
                    os.write(self.fd, bytes(message.pack(self.mavlink)))

    def join(self) -> None:
        self._thread.join()


@contextlib.contextmanager
def tcp_server() -> Iterator[tuple[str, list[Stream], socket.socket]]:
    streams: list[Stream] = []
    accepted: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            with contextlib.suppress(OSError):
                while True:
                    accepted.append(server.accept()[0])
                    streams.append(Stream(accepted[-1].fileno()))

        thread = threading.Thread(target=accept)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}", streams, server
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    for end in accepted:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
    for stream in streams:
        stream.join()
    for end in accepted:
        end.close()


@contextlib.contextmanager
def serial_line() -> Iterator[tuple[str, Stream]]:
    master, slave = pty.openpty()
    stream = Stream(master)
    yield f"serial://{os.ttyname(slave)}:57600", stream
    os.close(slave)
    stream.join()
    os.close(master)


# --- TCP and serial -------------------------------------------------------------------------------------


def test_a_drone_over_tcp_is_read_and_spoken_to() -> None:
    with tcp_server() as (url, streams, _):
        drone = make_drone(url)
        drone.open()
        readings = drone.read(1.5) + drone.read(1.5)
        drone.close()
    assert readings
    assert {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"} <= {m.get_type() for m in streams[0].heard}


def test_a_tcp_connection_that_ends_is_a_lost_link_and_comes_back() -> None:
    """As when ArduPilot reboots."""
    with tcp_server() as (url, streams, _):
        drone = make_drone(url)
        drone.open()
        until(lambda: bool(streams))
        with socket.socket(fileno=os.dup(streams[0].fd)) as end:
            end.shutdown(socket.SHUT_RDWR)
        with pytest.raises(LinkLost, match="closed the connection"):
            served(drone, 1.0)
        drone.close()
        drone.open()
        assert len(streams) == 2
        drone.close()


def test_nobody_at_a_tcp_port_is_a_lost_link() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    drone = make_drone(f"tcp://127.0.0.1:{port}")
    with pytest.raises(LinkLost, match="refused"):
        drone.open()
    drone.close()


def test_a_drone_on_a_serial_line_is_read_and_spoken_to() -> None:
    with serial_line() as (url, stream):
        drone = make_drone(url)
        drone.open()
        readings = drone.read(1.5) + drone.read(1.5)
        drone.close()
    assert readings
    assert {"HEARTBEAT", "COMMAND_LONG"} <= {m.get_type() for m in stream.heard}


def test_a_serial_line_that_is_not_there_says_what_to_do() -> None:
    drone = make_drone("serial:///dev/serial/by-id/none:57600")
    with pytest.raises(LinkLost, match="check the cable"):
        drone.open()
    drone.close()


def test_a_serial_line_that_is_behind_is_given_no_more_set_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pty never says that anything waits in it; the test says so in its place."""
    waiting = [0]
    master, slave = pty.openpty()
    monkeypatch.setattr("camrig_drivers.mavlink.wire._waiting", lambda fd: waiting[0])
    wire = SerialWire(os.ttyname(slave), 57600)
    encoder = Encoder()
    try:
        for step, behind in enumerate([0, 0, 2000, 2000, 2000, 0]):
            waiting[0] = behind
            wire.send(encoder.encode(PositionTarget((float(step), 0.0, 0.0), 0.0), (1, 1)), PEER)
        heard = _targets(master)
    finally:
        wire.close()
        os.close(slave)
        os.close(master)
    assert heard == [0.0, 1.0, 5.0]


def test_a_serial_line_that_takes_nothing_blocks_nobody() -> None:
    master, slave = pty.openpty()
    wire = SerialWire(os.ttyname(slave), 57600)
    try:
        started_s = time.monotonic()
        for _ in range(300):  # a pty takes 18 kB
            wire.send(bytes(250), PEER)
        taken_s = time.monotonic() - started_s
    finally:
        wire.close()
        os.close(slave)
        os.close(master)
    assert taken_s < 0.3  # it has waited for half a second


def test_a_serial_line_that_takes_nothing_for_seconds_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that were begun are ended, however many pieces that takes."""
    master, slave = pty.openpty()
    wire = SerialWire(os.ttyname(slave), 57600)
    frames = [bytes([step % 256]) * 250 for step in range(150)]
    try:
        for frame in frames:
            wire.send(frame, PEER)
        heard = _drained(master)
        wire.send(bytes(250), PEER)
        heard += _drained(master)
        whole, rest = divmod(len(heard), 250)
        assert not rest
        assert heard[: 250 * (whole - 1)] == b"".join(frames[: whole - 1])
        monkeypatch.setattr("camrig_drivers.mavlink.wire._UNTAKEN_S", 0.05)
        for _ in range(5):  # the kernel moves what it took from one buffer to the next, and then takes more
            _send_all(wire, frames)
        time.sleep(0.06)
        with pytest.raises(LinkLost, match="check its flow control"):
            wire.send(bytes(250), PEER)
    finally:
        wire.close()
        os.close(slave)
        os.close(master)


def test_a_tcp_connection_that_stands_still_holds_no_more_than_a_moment_of_set_points() -> None:
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        server.bind(("127.0.0.1", 0))
        server.listen()
        wire = TcpWire("127.0.0.1", server.getsockname()[1])
        end, _ = server.accept()
        encoder = Encoder()
        for step in range(1000):
            wire.send(encoder.encode(PositionTarget((float(step), 0.0, 0.0), 0.0), (1, 1)), PEER)
        time.sleep(0.1)
        there = _unread(end.fileno())
        end.settimeout(0.2)
        received = 0
        with contextlib.suppress(TimeoutError):
            while data := end.recv(4096):
                received += len(data)
        wire.close()
        end.close()
    assert received - there <= 1024 + 300


def _unread(fd: int) -> int:
    return int(struct.unpack("i", fcntl.ioctl(fd, termios.FIONREAD, bytes(4)))[0])


def _send_all(wire: SerialWire, frames: list[bytes]) -> None:
    with contextlib.suppress(LinkLost):
        for frame in frames:
            wire.send(frame, PEER)
    time.sleep(0.02)


def _drained(fd: int) -> bytes:
    heard = b""
    while select.select([fd], [], [], 0.1)[0]:
        heard += os.read(fd, 4096)
    return heard


def _targets(fd: int) -> list[float]:
    parser = dialect.MAVLink(None)
    found: list[float] = []
    while select.select([fd], [], [], 0.1)[0]:
        found += [m.x for m in parser.parse_buffer(bytearray(os.read(fd, 4096))) or []]
    return found


def test_timesync_is_asked_and_answered_with_the_clock_of_the_poses() -> None:
    with listening() as peer, opened(make_drone(url_of(peer)), peer) as drone:
        served(drone, 0.05)
        asked_ns = [m.ts1 for m in peer.heard(0.05) if m.get_type() == "TIMESYNC" and m.tc1 == 0]
        peer.say(dialect.MAVLink_timesync_message(0, 4711))
        served(drone, 0.05)
        (answer,) = [m for m in peer.heard(0.05) if m.get_type() == "TIMESYNC" and m.ts1 == 4711]
        now_ns = time.monotonic_ns()
    assert 0 < now_ns - asked_ns[0] < 2e9
    assert 0 < now_ns - answer.tc1 < 1e9


# --- signatures -----------------------------------------------------------------------------------------


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "mavlink.key"
    path.write_text(KEY.hex())
    path.chmod(0o600)
    return path


def signing(key_file: Path, link: int = 0, now_s: float = NOON_S) -> Signing:
    return Signing(key_file, link, key_file.parent, lambda: now_s)


def stamp_of(frame: bytes) -> tuple[int, int]:
    """Return link id and time stamp of a signed frame."""
    return frame[-13], int.from_bytes(frame[-12:-6], "little")


def test_frames_are_signed_with_key_link_and_stamp(key_file: Path) -> None:
    frame = Encoder(Seals(signing(key_file, 7))).encode(OwnHeartbeat(), (0, 0))
    link, stamp = stamp_of(frame)
    assert (frame[2], link) == (1, 7)
    assert stamp == round((NOON_S - 1_420_070_400) * 1e5)  # 10 us since 2015
    receiver = dialect.MAVLink(None)
    receiver.signing.secret_key = KEY
    assert receiver.decode(bytearray(frame)).get_signed()


def test_stamps_go_on_above_the_last_ones_when_the_clock_was_set_back(key_file: Path) -> None:
    """A reboot without a clock, in 2015 again: the autopilot would refuse everything for years."""
    first = Encoder(Seals(signing(key_file)))
    last = max(stamp_of(first.encode(OwnHeartbeat(), (0, 0)))[1] for _ in range(100))
    again = Encoder(Seals(signing(key_file, now_s=1_420_070_500.0)))
    assert stamp_of(again.encode(OwnHeartbeat(), (0, 0)))[1] > last


def test_a_link_that_is_opened_again_and_again_still_hears_a_vehicle_whose_clock_is_right(key_file: Path) -> None:
    """It waits for a drone that is switched off; pymavlink does not hear who is a minute behind our stamp."""
    ours, last = signing(key_file), 0
    for _ in range(20):
        seals = Seals(ours)
        stamp = stamp_of(Encoder(seals).encode(OwnHeartbeat(), (0, 0)))[1]
        assert stamp > last
        last = stamp
    vehicle = Encoder(Seals(Signing(key_file, 1, key_file.parent / "vehicle", lambda: NOON_S)))
    assert [packet for _, packet in Decoder(seals).feed(vehicle.encode(TimeSync(1, 2), (1, 1)))] == [TimeSync(1, 2)]


def test_stamps_ascend_while_the_clock_stands_and_follow_it_when_it_runs(key_file: Path) -> None:
    now_s = [NOON_S]
    encoder = Encoder(Seals(Signing(key_file, 0, key_file.parent, lambda: now_s[0])))
    stamps = [stamp_of(encoder.encode(OwnHeartbeat(), (0, 0)))[1] for _ in range(3)]
    now_s[0] += 3600.0
    stamps.append(stamp_of(encoder.encode(OwnHeartbeat(), (0, 0)))[1])
    assert stamps == sorted(set(stamps))
    assert stamps[-1] - stamps[0] == 3600 * 100_000
    assert int((key_file.parent / "mavlink-signing-0").read_text()) > stamps[-1]  # kept ahead of its use


def test_what_is_not_signed_or_not_by_the_key_or_replayed_is_not_heard(key_file: Path) -> None:
    seals = Seals(signing(key_file))
    decoder = Decoder(seals)
    other = key_file.with_name("other.key")
    other.write_bytes(bytes(32))
    other.chmod(0o600)
    good, wrong = Encoder(Seals(signing(key_file, 1))), Encoder(Seals(signing(other, 2)))
    frame = good.encode(TimeSync(1, 2), (1, 1))
    assert [packet for _, packet in decoder.feed(frame)] == [TimeSync(1, 2)]
    assert list(decoder.feed(frame)) == []  # a replay
    assert list(decoder.feed(wrong.encode(TimeSync(1, 2), (1, 1)))) == []
    assert list(decoder.feed(Encoder().encode(TimeSync(1, 2), (1, 1)))) == []
    assert seals.refused == 3


def test_a_damaged_stamp_costs_its_own_frame_alone(key_file: Path) -> None:
    """No checksum covers a signature: what a radio makes of a stamp may lie years ahead."""
    decoder, good = Decoder(Seals(signing(key_file))), Encoder(Seals(signing(key_file, 1)))
    damaged = bytearray(good.encode(TimeSync(1, 2), (1, 1)))
    damaged[-7] ^= 0x80  # the highest byte of the stamp
    assert list(decoder.feed(bytes(damaged))) == []
    assert [packet for _, packet in decoder.feed(good.encode(TimeSync(1, 2), (1, 1)))] == [TimeSync(1, 2)]


def test_a_disk_that_fills_up_in_flight_silences_nobody(key_file: Path, caplog: pytest.LogCaptureFixture) -> None:
    now_s = [NOON_S]
    folder = key_file.parent / "state"
    encoder = Encoder(Seals(Signing(key_file, 0, folder, lambda: now_s[0])))
    (folder / "mavlink-signing-0").unlink()
    folder.rmdir()
    folder.write_text("no folder any more")
    stamps = []
    for _ in range(100):
        now_s[0] += 1.0
        stamps.append(stamp_of(encoder.encode(OwnHeartbeat(), (0, 0)))[1])
    assert stamps == sorted(set(stamps))
    assert 1 <= caplog.text.count("cannot be kept") < 10  # and not at every set-point
    with pytest.raises(InputError, match="cannot be kept"):
        Signing(key_file, 0, folder).begin()


def test_an_unsigned_link_hears_signed_frames_and_signs_nothing(key_file: Path) -> None:
    signed = Encoder(Seals(signing(key_file))).encode(OwnHeartbeat(), (0, 0))
    assert [type(packet) for _, packet in Decoder().feed(signed)] == [Heartbeat]
    assert Encoder().encode(OwnHeartbeat(), (0, 0))[2] == 0


def test_a_vehicle_that_does_not_sign_is_not_opened_and_the_reason_is_said(key_file: Path) -> None:
    with listening() as peer:
        clock = LeapClock()
        link = Link(url_of(peer), clock, signing(key_file))
        drone = MavlinkDrone(SPEC, MavlinkSection(url=url_of(peer)), link, clock)

        def greet_and_wait() -> None:
            peer.heard(0.05)
            peer.say(heartbeat())
            until(lambda: link.refused > 0)
            clock.ahead_s += 10.0

        greeter = threading.Thread(target=greet_and_wait)
        greeter.start()
        with pytest.raises(LinkLost, match="1 frames were not signed with its key"):
            drone.open()
        greeter.join()


def test_a_signed_vehicle_is_flown_signed(key_file: Path) -> None:
    with listening() as peer:
        mavlink = peer._mavlink
        mavlink.signing.secret_key, mavlink.signing.sign_outgoing, mavlink.signing.link_id = KEY, True, 3
        mavlink.signing.timestamp = round((time.time() - 1_420_070_400) * 1e5)
        link = Link(url_of(peer), RealClock(), Signing(key_file, 0, key_file.parent))
        with opened(MavlinkDrone(SPEC, MavlinkSection(url=url_of(peer)), link), peer) as drone:
            peer.say(*parameters(), *telemetry(1000))
            served(drone, 0.05)
            assert all(message.get_signed() for message in peer.heard(0.05))


@pytest.mark.parametrize(
    ("content", "mode", "text"),
    [
        (KEY.hex().encode(), 0o604, "open to everybody"),
        (b"short", 0o600, "64 hexadecimal digits"),
        (None, 0o600, "cannot be read"),
    ],
)
def test_a_key_that_cannot_be_used_is_named(tmp_path: Path, content: bytes | None, mode: int, text: str) -> None:
    path = tmp_path / "mavlink.key"
    if content is not None:
        path.write_bytes(content)
        path.chmod(mode)
    with pytest.raises(InputError, match=text):
        read_key(path)


def test_links_of_one_key_need_numbers_of_their_own(key_file: Path) -> None:
    a = MavlinkSection(url="udp://127.0.0.1:14550", signing=SigningSection(key_file=key_file))
    b = a.model_copy(update={"url": "udp://127.0.0.1:14560"})
    c = a.model_copy(update={"signing": None, "system": 2})
    assert driver.check is not None
    assert [(name, key) for name, key, _ in driver.check({"a": (SPEC, a), "b": (SPEC, b)})] == [("b", "signing")]
    assert [(name, key) for name, key, _ in driver.check({"a": (SPEC, a), "c": (SPEC, c)})] == [("c", "signing")]
    other = b.model_copy(update={"signing": SigningSection(key_file=key_file, link=1)})
    assert not driver.check({"a": (SPEC, a), "b": (SPEC, other)})
