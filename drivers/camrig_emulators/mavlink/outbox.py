"""Who listens to the emulated drone, and what is sent to whom when: streams, texts, news of a mode."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.history import STEP_S
from camrig_emulators.mavlink.messages import TELEMETRY, Message, Report
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.udp_port import Address, Datagram

_COMPONENT = 1
_HEARTBEAT = 0
_HEARD_FOR_S = 5.0
_MAX_PEERS = 16
_TEXT_BYTES = 50


@dataclass(slots=True)
class Stream:
    """A message that is sent again and again."""

    interval_s: float
    due_s: float


@dataclass(eq=False)
class Peer:
    """One link: its parser and packer (sequence numbers), its streams."""

    mav: Any
    heard_s: float
    streams: dict[int, Stream] = field(default_factory=dict)


class Outbox:
    """Collects datagrams until ``flush``. A peer is listened to for 5 s after its last word, the target for ever."""

    def __init__(self, vehicle: Vehicle, faults: Faults, target: Address | None) -> None:
        self._vehicle = vehicle
        self._faults = faults
        self._target = target
        self._peers: dict[Address, Peer] = {}
        self._datagrams: list[Datagram] = []
        self._report: Report | None = None
        self._mode = vehicle.firmware.custom_mode
        self._heartbeat_at_s = math.inf
        self._texts_sent = 0
        if target is not None:
            self.peer(target, vehicle.history.latest.stamp_s)

    def peer(self, address: Address, now_s: float) -> Peer:
        """Return the link to an address, a new one with the default streams where it is unknown."""
        if address not in self._peers:
            if len(self._peers) >= _MAX_PEERS:
                others = (known for known in self._peers if known != self._target)
                del self._peers[min(others, key=lambda known: self._peers[known].heard_s)]
            mav = dialect.MAVLink(None, srcSystem=self._vehicle.settings.system, srcComponent=_COMPONENT)
            mav.robust_parsing = True  # garbage becomes BAD_DATA instead of an exception
            self._peers[address] = Peer(mav, now_s)
            self._default_streams(self._peers[address], now_s)
        return self._peers[address]

    def listeners(self, now_s: float) -> list[Address]:
        """Return who gets telemetry."""
        return [a for a, peer in self._peers.items() if a == self._target or now_s - peer.heard_s <= _HEARD_FOR_S]

    def send(self, address: Address, message: Message) -> None:
        """Pack a message for one peer; None, a telemetry that has nothing to tell yet, is no message."""
        if message is None:
            return
        mav = self._peers[address].mav
        self._datagrams.append((address, bytes(message.pack(mav))))
        mav.seq = (mav.seq + 1) % 256

    def set_interval(self, address: Address, number: int, interval_s: float, now_s: float) -> None:
        """Send a message at an interval, 0 for its default, negative for never."""
        streams = self._peers[address].streams
        default_hz = self._vehicle.firmware.default_streams_hz.get(number, 0.0)
        if interval_s == 0.0 and default_hz > 0.0:
            interval_s = 1.0 / default_hz
        if interval_s > 0.0:
            streams[number] = Stream(max(interval_s, STEP_S), now_s)
        else:
            streams.pop(number, None)

    def restart(self) -> None:
        """Forget what peers asked for, as a reboot does."""
        self._mode = self._vehicle.firmware.custom_mode
        self._heartbeat_at_s = math.inf
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
        self._announce_mode(now_s)
        self._send_texts(now_s)
        report = self.report(now_s)
        for address in self.listeners(now_s):
            for number, stream in self._peers[address].streams.items():
                if stream.due_s <= now_s:
                    self.send(address, TELEMETRY[number](report))
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
        rates_hz = self._vehicle.firmware.default_streams_hz
        peer.streams = {number: Stream(1.0 / rate_hz, now_s) for number, rate_hz in rates_hz.items()}

    def _announce_mode(self, now_s: float) -> None:
        firmware = self._vehicle.firmware
        if firmware.custom_mode != self._mode:
            self._mode = firmware.custom_mode
            self._heartbeat_at_s = now_s + firmware.heartbeat_delay_s
        if self._heartbeat_at_s <= now_s:
            self._heartbeat_at_s = math.inf
            for address in self.listeners(now_s):
                self.send(address, TELEMETRY[_HEARTBEAT](self.report(now_s)))

    def _send_texts(self, now_s: float) -> None:
        texts = self._vehicle.cockpit.texts
        while texts and self._vehicle.firmware.talks:
            severity, text = texts.popleft()
            self._send_text(now_s, severity, (text + self._vehicle.firmware.text_ending).encode())

    def _send_text(self, now_s: float, severity: int, text: bytes) -> None:
        chunks = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        self._texts_sent = self._texts_sent % 0xFFFF + 1
        number = self._texts_sent if len(chunks) > 1 else 0
        for index, chunk in enumerate(chunks):
            for address in self.listeners(now_s):
                self.send(address, dialect.MAVLink_statustext_message(severity, chunk, number, index))
