"""The emulated drone's MAVLink: what it makes of datagrams, and which it sends when. No socket, no clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from camrig_emulators.faults import Faults
from camrig_emulators.mavlink_cockpit import ACCEPTED, DENIED, FAILED, SetPoint
from camrig_emulators.mavlink_messages import TELEMETRY, Message, Report
from camrig_emulators.mavlink_vehicle import Vehicle

Address = tuple[str, int]
Datagram = tuple[Address, bytes]

_COMPONENT = 1
_HEARD_FOR_S = 5.0
_MAX_PEERS = 16
_KEPT_RECEIVED = 50_000
_TEXT_BYTES = 50
_GROUND_STATION = 6  # MAV_TYPE_GCS
_SET_MODE_COMMAND = 176
_COMMANDS = {"COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_LOCAL_NED"}  # what a fault may drop
# REQUEST_DATA_STREAM's groups, and the messages of ours that are in them
_GROUPS = {0: tuple(TELEMETRY), 2: (1, 24), 6: (32, 33), 10: (30, 31), 11: (147,), 12: (147, 245)}


@dataclass(slots=True)
class _Stream:
    interval_s: float
    due_s: float


@dataclass(eq=False)
class _Peer:
    """One link: its parser, its sequence numbers, its streams."""

    mav: Any
    heard_s: float
    streams: dict[int, _Stream] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Received:
    """One message that arrived."""

    stamp_s: float
    name: str
    fields: dict[str, Any]


class MavlinkProtocol:
    """One vehicle on one port. Every call brings the vehicle up to ``now_s`` and returns datagrams to send."""

    def __init__(self, vehicle: Vehicle, faults: Faults, seed: int, target: Address | None = None) -> None:
        self.vehicle = vehicle
        self._faults = faults
        self.received: deque[Received] = deque(maxlen=_KEPT_RECEIVED)
        self._target = target
        self._rng = np.random.default_rng([seed, vehicle.settings.system, 2])
        self._peers: dict[Address, _Peer] = {}
        self._heard_at_s = 0.0
        self._last_report: Report | None = None
        self._heartbeat_at_s = math.inf
        self._mode = vehicle.firmware.custom_mode
        self._texts_sent = 0
        self._out: list[Datagram] = []
        self._handlers: dict[str, Callable[[Address, Any], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "COMMAND_LONG": self._on_command_long,
            "COMMAND_INT": self._on_command_int,
            "SET_POSITION_TARGET_LOCAL_NED": self._on_set_point,
            "TIMESYNC": self._on_timesync,
            "PING": self._on_ping,
            "PARAM_REQUEST_READ": self._on_param_read,
            "PARAM_REQUEST_LIST": self._on_param_list,
            "PARAM_SET": self._on_param_set,
            "REQUEST_DATA_STREAM": self._on_data_stream,
        }
        if target is not None:
            self._peer(target, vehicle.history.latest.stamp_s)

    @property
    def _now_s(self) -> float:
        return self.vehicle.history.latest.stamp_s

    def receive(self, now_s: float, address: Address, data: bytes) -> list[Datagram]:
        """Take one datagram; an autopilot that boots hears nothing."""
        self.vehicle.advance_to(now_s)
        if now_s < self.vehicle.silent_until_s:
            return []
        peer = self._peer(address, now_s)
        peer.heard_s = self._heard_at_s = now_s
        for message in peer.mav.parse_buffer(data) or ():
            self._take(address, message)
        return self.poll(now_s)

    def poll(self, now_s: float) -> list[Datagram]:
        """Send what is due."""
        self.vehicle.advance_to(now_s)
        if now_s >= self.vehicle.silent_until_s:
            self._announce_mode(now_s)
            self._send_texts(now_s)
            self._send_streams(now_s)
        out, self._out = self._out, []
        return out

    def next_due_s(self, now_s: float) -> float:
        """Return when ``poll`` has something to send at the latest."""
        streams = [s.due_s for address in self._listeners(now_s) for s in self._peers[address].streams.values()]
        return max(self.vehicle.silent_until_s, min([self._heartbeat_at_s, *streams]))

    def peers(self, now_s: float) -> int:
        """Return how many listen."""
        return len(self._listeners(now_s))

    # --- out ----------------------------------------------------------------------------------------------

    def _peer(self, address: Address, now_s: float) -> _Peer:
        if address not in self._peers:
            if len(self._peers) >= _MAX_PEERS:
                silent = min((a for a in self._peers if a != self._target), key=lambda a: self._peers[a].heard_s)
                del self._peers[silent]
            mav = dialect.MAVLink(None, srcSystem=self.vehicle.settings.system, srcComponent=_COMPONENT)
            mav.robust_parsing = True  # garbage becomes BAD_DATA instead of an exception
            self._peers[address] = _Peer(mav, now_s)
            self._default_streams(self._peers[address], now_s)
        return self._peers[address]

    def _default_streams(self, peer: _Peer, now_s: float) -> None:
        rates_hz = self.vehicle.firmware.default_streams_hz
        peer.streams = {number: _Stream(1.0 / rate_hz, now_s) for number, rate_hz in rates_hz.items()}

    def _listeners(self, now_s: float) -> list[Address]:
        return [a for a, peer in self._peers.items() if a == self._target or now_s - peer.heard_s <= _HEARD_FOR_S]

    def _send(self, address: Address, message: Message) -> None:
        if message is None:
            return
        mav = self._peers[address].mav
        self._out.append((address, bytes(message.pack(mav))))
        mav.seq = (mav.seq + 1) % 256

    def _report(self, now_s: float) -> Report:
        if self._last_report is None or not self._faults.freeze:
            stamp_s = now_s - self.vehicle.settings.telemetry_latency_s
            self._last_report = Report(self.vehicle, *self.vehicle.history.before(stamp_s))
        return self._last_report

    def _send_streams(self, now_s: float) -> None:
        report = self._report(now_s)
        for address in self._listeners(now_s):
            for number, stream in self._peers[address].streams.items():
                if stream.due_s <= now_s:
                    self._send(address, TELEMETRY[number](report))
                    stream.due_s = max(stream.due_s + stream.interval_s, now_s)

    def _announce_mode(self, now_s: float) -> None:
        firmware = self.vehicle.firmware
        if firmware.custom_mode != self._mode:
            self._mode = firmware.custom_mode
            self._heartbeat_at_s = now_s + firmware.heartbeat_delay_s
        if self._heartbeat_at_s <= now_s:
            self._heartbeat_at_s = math.inf
            for address in self._listeners(now_s):
                self._send(address, TELEMETRY[0](self._report(now_s)))

    def _send_texts(self, now_s: float) -> None:
        texts = self.vehicle.cockpit.texts
        while texts and self.vehicle.firmware.talks:
            severity, text = texts.popleft()
            self._send_text(now_s, severity, (text + self.vehicle.firmware.text_ending).encode())

    def _send_text(self, now_s: float, severity: int, text: bytes) -> None:
        chunks = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        self._texts_sent += 1
        number = self._texts_sent if len(chunks) > 1 else 0
        for index, chunk in enumerate(chunks):
            for address in self._listeners(now_s):
                self._send(address, dialect.MAVLink_statustext_message(severity, chunk, number, index))

    # --- in -----------------------------------------------------------------------------------------------

    def _take(self, address: Address, message: Any) -> None:
        name = message.get_type()
        if name == "BAD_DATA" or name.startswith("UNKNOWN_"):
            return
        if name in _COMMANDS and self._faults.take_drop():
            return
        fields = message.to_dict()
        fields.pop("mavpackettype")
        self.received.append(Received(self._heard_at_s, name, fields))
        ours = fields.get("target_system", 0) in {0, self.vehicle.settings.system}
        ours = ours and fields.get("target_component", 0) in {0, _COMPONENT}
        handler = self._handlers.get(name)
        if ours and handler is not None:
            handler(address, message)

    def _on_heartbeat(self, address: Address, message: Any) -> None:
        del address
        if message.type == _GROUND_STATION:
            self.vehicle.firmware.ground_station_beat(message.get_srcSystem())

    def _on_command_long(self, address: Address, message: Any) -> None:
        self._on_command(address, message, [getattr(message, f"param{i}") for i in range(1, 8)])

    def _on_command_int(self, address: Address, message: Any) -> None:
        first = [getattr(message, f"param{i}") for i in range(1, 5)]
        self._on_command(address, message, [*first, float(message.x), float(message.y), message.z])

    def _on_command(self, address: Address, message: Any, params: list[float]) -> None:
        command = int(message.command)
        reply: Message = None
        match command:
            case 246:
                result: int | None = self._reboot_result(params)
            case 511:
                result = self._set_interval(address, int(params[0]), params[1])
            case 512:
                builder = TELEMETRY.get(int(params[0]))
                reply = builder(self._report(self._now_s)) if builder is not None else None
                result = ACCEPTED if reply is not None else FAILED
            case _:
                a, b, c, d, e, f, g = params
                result = self.vehicle.firmware.command(command, (a, b, c, d, e, f, g))
        if result is not None:
            self._acknowledge(address, message, command, result)
        self._send(address, reply)
        if command == 246 and result == ACCEPTED:
            self._reboot()

    def _acknowledge(self, address: Address, message: Any, command: int, result: int) -> None:
        asker = (message.get_srcSystem(), message.get_srcComponent())
        twice = command == _SET_MODE_COMMAND and self._rng.random() < self.vehicle.firmware.double_ack_rate
        for _ in range(2 if twice else 1):
            self._send(address, dialect.MAVLink_command_ack_message(command, result, 0, 0, *asker))

    def _set_interval(self, address: Address, number: int, interval_us: float) -> int:
        if number not in TELEMETRY or math.isnan(interval_us):
            return FAILED
        streams = self._peers[address].streams
        default_hz = self.vehicle.firmware.default_streams_hz.get(number)
        if interval_us == 0.0 and default_hz is not None:
            streams[number] = _Stream(1.0 / default_hz, self._now_s)
        elif interval_us > 0.0:
            streams[number] = _Stream(interval_us / 1e6, self._now_s)
        else:
            streams.pop(number, None)
        return ACCEPTED

    def _on_data_stream(self, address: Address, message: Any) -> None:
        for number in _GROUPS.get(message.req_stream_id, ()):
            if message.start_stop and message.req_message_rate:
                self._set_interval(address, number, 1e6 / message.req_message_rate)
            elif number:
                self._set_interval(address, number, -1.0)

    def _reboot_result(self, params: list[float]) -> int:
        if params[0] != 1.0:
            return DENIED
        return FAILED if self.vehicle.cockpit.armed else ACCEPTED

    def _reboot(self) -> None:
        self.vehicle.reboot()
        self._mode = self.vehicle.firmware.custom_mode
        for peer in self._peers.values():
            self._default_streams(peer, self.vehicle.silent_until_s)

    def _on_set_point(self, address: Address, message: Any) -> None:
        del address
        self.vehicle.firmware.set_point(
            SetPoint(
                coordinate_frame=message.coordinate_frame,
                type_mask=message.type_mask,
                position=np.array([message.x, message.y, message.z], dtype=float),
                velocity=np.array([message.vx, message.vy, message.vz], dtype=float),
                yaw_rad=message.yaw,
                yaw_rate_rad_s=message.yaw_rate,
            )
        )

    def _on_timesync(self, address: Address, message: Any) -> None:
        if message.tc1 == 0:
            self._send(address, dialect.MAVLink_timesync_message(self.vehicle.boot_ns(self._now_s), message.ts1))

    def _on_ping(self, address: Address, message: Any) -> None:
        if message.target_system == 0 and message.target_component == 0:
            asker = (message.get_srcSystem(), message.get_srcComponent())
            self._send(address, dialect.MAVLink_ping_message(message.time_usec, message.seq, *asker))

    def _send_param(self, address: Address, name: str) -> None:
        params = self.vehicle.cockpit.params
        index = params.names.index(name)
        value, kind, count = params.encode(name), params.kind(name), len(params)
        self._send(address, dialect.MAVLink_param_value_message(name.encode(), value, kind, count, index))

    def _on_param_read(self, address: Address, message: Any) -> None:
        names = self.vehicle.cockpit.params.names
        name = names[message.param_index] if 0 <= message.param_index < len(names) else message.param_id
        if message.param_index < len(names) and name in names:
            self._send_param(address, name)

    def _on_param_list(self, address: Address, message: Any) -> None:
        del message
        for name in self.vehicle.cockpit.params.names:
            self._send_param(address, name)

    def _on_param_set(self, address: Address, message: Any) -> None:
        params = self.vehicle.cockpit.params
        if message.param_id in params.names:
            params.set(message.param_id, params.decode(message.param_id, message.param_value))
            self._send_param(address, message.param_id)
