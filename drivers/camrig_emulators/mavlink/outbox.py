"""Who listens to the emulated drone on one link, and what is sent to whom when: streams, texts, news of a mode."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.delayed import Address, Datagram
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.history import STEP_S
from camrig_emulators.mavlink.messages import Message, Report
from camrig_emulators.mavlink.messages_more import MESSAGES
from camrig_emulators.mavlink.vehicle import Vehicle

_COMPONENT = 1
_HEARTBEAT = 0
_HEARD_FOR_S = 5.0
_MAX_PEERS = 16
_TEXT_BYTES = 50
_BOOT_NOISE = bytes.fromhex("00 7f ff 80 55 13 00")
_RADIO_STATUS = 109


@dataclass(slots=True)
class Stream:
    """A message that is sent again and again."""

    interval_s: float
    due_s: float


@dataclass(eq=False)
class Peer:
    """One address: its parser and packer (sequence numbers, signatures), its streams."""

    mav: Any
    heard_s: float
    streams: dict[int, Stream] = field(default_factory=dict)


class Outbox:
    """Collects datagrams until ``flush``. An address is spoken to for 5 s after its last word, a kept one for ever."""

    def __init__(self, vehicle: Vehicle, faults: Faults, channel: int) -> None:
        self._vehicle = vehicle
        self._faults = faults
        self._channel = channel
        self._kept: set[Address] = set()
        self._peers: dict[Address, Peer] = {}
        self._datagrams: list[Datagram] = []
        self._report: Report | None = None
        self._mode = vehicle.firmware.custom_mode
        self._heartbeat_at_s = math.inf
        self._texts_seen = 0
        self._chunked = 0
        self._boots = vehicle.boots
        self._signing = vehicle.signing
        self._noise: bytes | None = None

    def keep(self, address: Address, now_s: float) -> None:
        """Speak to an address until ``forget``."""
        self._kept.add(address)
        self.peer(address, now_s)

    def forget(self, address: Address) -> None:
        """Drop an address and what it asked for."""
        self._kept.discard(address)
        self._peers.pop(address, None)

    def peer(self, address: Address, now_s: float) -> Peer:
        """Return an address's parser and streams, new ones where it is unknown."""
        if address not in self._peers:
            if len(self._peers) >= _MAX_PEERS:
                others = (known for known in self._peers if known not in self._kept)
                del self._peers[min(others, key=lambda known: self._peers[known].heard_s)]
            mav = dialect.MAVLink(None, srcSystem=self._vehicle.settings.system, srcComponent=_COMPONENT)
            mav.robust_parsing = True  # garbage becomes BAD_DATA instead of an exception
            self._peers[address] = Peer(mav, now_s)
            self._default_streams(self._peers[address], now_s)
            self._sign(mav, now_s)
        return self._peers[address]

    def listeners(self, now_s: float) -> list[Address]:
        """Return who gets telemetry."""
        return [a for a, peer in self._peers.items() if a in self._kept or now_s - peer.heard_s <= _HEARD_FOR_S]

    def send(self, address: Address, message: Message) -> None:
        """Pack a message for one peer; None, a telemetry that has nothing to tell yet, is no message."""
        if message is None or address not in self._peers:
            return
        mav = self._peers[address].mav
        self._datagrams.append((address, bytes(message.pack(mav))))
        mav.seq = (mav.seq + 1) % 256

    def make_noise(self, noise: bytes) -> None:
        """Put bytes that are no message in front of the next ones."""
        self._noise = noise

    def set_interval(self, address: Address, number: int, interval_s: float, now_s: float) -> None:
        """Send a message at an interval, 0 for its default, negative for never."""
        streams = self._peers[address].streams
        default_hz = self._default_streams_hz.get(number, 0.0)
        if interval_s == 0.0 and default_hz > 0.0:
            interval_s = 1.0 / default_hz
        if interval_s > 0.0:
            streams[number] = Stream(max(interval_s, STEP_S), now_s)
        else:
            streams.pop(number, None)

    def interval_s(self, address: Address, number: int) -> float:
        """Return at which interval a message goes to an address; negative for never."""
        stream = self._peers[address].streams.get(number)
        return -1.0 if stream is None else stream.interval_s

    def catch_up(self, now_s: float) -> None:
        """Follow the vehicle: a new key, or a boot after which nothing that peers asked for is known."""
        if self._signing is not self._vehicle.signing:
            self._signing = self._vehicle.signing
            for peer in self._peers.values():
                self._sign(peer.mav, now_s)
        if self._boots != self._vehicle.boots:
            self._boots = self._vehicle.boots
            self._mode = self._vehicle.firmware.custom_mode
            self._heartbeat_at_s = math.inf
            self._texts_seen = 0
            self._noise = _BOOT_NOISE
            for peer in self._peers.values():
                self._default_streams(peer, self._vehicle.silent_until_s)

    def report(self, now_s: float) -> Report:
        """Return what telemetry knows now; the same for ever while it is frozen."""
        if self._report is None or not self._faults.freeze:
            stamp_s = now_s - self._vehicle.settings.telemetry_latency_s
            self._report = Report(self._vehicle, *self._vehicle.history.before(stamp_s))
        return self._report

    def collect(self, now_s: float) -> None:
        """Put in whatever is due."""
        if self._noise is not None:
            self._datagrams += [(address, self._noise) for address in self.listeners(now_s)]
            self._noise = None
        self._announce_mode(now_s)
        self._send_texts(now_s)
        report = self.report(now_s)
        tell = MESSAGES[self._vehicle.firmware.autopilot]
        for address in self.listeners(now_s):
            for number, stream in self._peers[address].streams.items():
                if stream.due_s <= now_s:
                    self.send(address, tell[number](report))
                    stream.due_s = max(stream.due_s + stream.interval_s, now_s)

    def flush(self) -> list[Datagram]:
        """Hand over what was put in."""
        datagrams, self._datagrams = self._datagrams, []
        return datagrams

    def next_due_s(self, now_s: float) -> float:
        """Return when the next thing is due, as far as that is known."""
        streams = [stream.due_s for a in self.listeners(now_s) for stream in self._peers[a].streams.values()]
        return min([self._heartbeat_at_s, *streams])

    def _default_streams(self, peer: Peer, now_s: float) -> None:
        rates_hz = self._default_streams_hz
        peer.streams = {number: Stream(1.0 / rate_hz, now_s) for number, rate_hz in rates_hz.items()}

    @property
    def _default_streams_hz(self) -> dict[int, float]:
        return {**self._vehicle.firmware.default_streams_hz, **self._vehicle.settings.streams_hz}

    def _sign(self, mav: Any, now_s: float) -> None:
        """Channel 0, the one by USB, neither signs nor asks for signatures."""
        told = self._signing if self._channel > 0 else None
        signing = mav.signing
        signing.secret_key = None if told is None else told.key
        signing.sign_outgoing = told is not None
        signing.link_id = self._channel
        signing.allow_unsigned_callback = lambda _, number: number == _RADIO_STATUS
        if told is not None:
            signing.timestamp = told.timestamp_at(now_s)
            signing.stream_timestamps = {}

    def _announce_mode(self, now_s: float) -> None:
        firmware = self._vehicle.firmware
        if firmware.custom_mode != self._mode:
            self._mode = firmware.custom_mode
            self._heartbeat_at_s = now_s + firmware.heartbeat_delay_s
        if self._heartbeat_at_s <= now_s:
            self._heartbeat_at_s = math.inf
            for address in self.listeners(now_s):
                self.send(address, MESSAGES[firmware.autopilot][_HEARTBEAT](self.report(now_s)))

    def _send_texts(self, now_s: float) -> None:
        firmware = self._vehicle.firmware
        if not firmware.talks:
            return
        for said in [text for text in self._vehicle.cockpit.texts if text.number > self._texts_seen]:
            self._texts_seen = said.number
            self._send_text(now_s, said.severity, (said.text + firmware.text_ending).encode())

    def _send_text(self, now_s: float, severity: int, text: bytes) -> None:
        chunks = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        self._chunked = self._chunked % 0xFFFF + (1 if len(chunks) > 1 else 0)
        number = self._chunked if len(chunks) > 1 else 0
        for index, chunk in enumerate(chunks):
            for address in self.listeners(now_s):
                self.send(address, dialect.MAVLink_statustext_message(severity, chunk, number, index))
