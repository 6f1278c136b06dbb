"""What the emulated drone makes of the MAVLink it hears: stamps and datagrams in, datagrams out; no socket."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.cockpit import ACCEPTED, DENIED, FAILED
from camrig_emulators.mavlink.firmware import whole
from camrig_emulators.mavlink.messages import TELEMETRY, Message
from camrig_emulators.mavlink.outbox import Outbox
from camrig_emulators.mavlink.set_points import SetPoint
from camrig_emulators.mavlink.vehicle import Vehicle
from camrig_emulators.udp_port import Address, Datagram

_COMPONENT = 1
_KEPT_RECEIVED = 50_000
_GROUND_STATION = 6  # MAV_TYPE_GCS
_SET_MODE, _REBOOT, _SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE = 176, 246, 511, 512  # MAV_CMD
_DROPPABLE = {"COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_LOCAL_NED"}
# REQUEST_DATA_STREAM's groups, and the messages of ours that are in them
_GROUPS = {0: (1, 24, 30, 32, 33, 147, 245), 2: (1, 24), 6: (32, 33), 10: (30,), 11: (147,), 12: (147, 245)}


@dataclass(frozen=True, slots=True)
class Received:
    """One message that the drone heard."""

    stamp_s: float
    name: str
    fields: dict[str, Any]


class MavlinkProtocol:
    """One vehicle on one port. Every call brings the vehicle up to ``now_s`` and returns datagrams to send."""

    def __init__(self, vehicle: Vehicle, faults: Faults, seed: int, target: Address | None = None) -> None:
        self.vehicle = vehicle
        self.received: deque[Received] = deque(maxlen=_KEPT_RECEIVED)
        self._faults = faults
        self._outbox = Outbox(vehicle, faults, target)
        self._rng = np.random.default_rng([seed, vehicle.settings.system, 2])
        self._now_s = vehicle.history.latest.stamp_s
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

    def receive(self, now_s: float, address: Address, data: bytes) -> list[Datagram]:
        """Take one datagram; an autopilot that boots hears nothing."""
        self._now_s = now_s
        self.vehicle.advance_to(now_s)
        if now_s < self.vehicle.silent_until_s:
            return []
        peer = self._outbox.peer(address, now_s)
        peer.heard_s = now_s
        for message in peer.mav.parse_buffer(data) or ():
            self._take(address, message)
        return self.poll(now_s)

    def poll(self, now_s: float) -> list[Datagram]:
        """Send what is due."""
        self._now_s = now_s
        self.vehicle.advance_to(now_s)
        if now_s >= self.vehicle.silent_until_s:
            self._outbox.collect(now_s)
        return self._outbox.flush()

    def next_due_s(self, now_s: float) -> float:
        """Return when ``poll`` will have something to send, as far as that is known."""
        return max(self.vehicle.silent_until_s, self._outbox.next_due_s(now_s))

    def listeners(self, now_s: float) -> int:
        """Return how many get telemetry."""
        return len(self._outbox.listeners(now_s))

    def _take(self, address: Address, message: Any) -> None:
        name = message.get_type()
        if name == "BAD_DATA" or name.startswith("UNKNOWN_"):
            return
        if name in _DROPPABLE and self._faults.take_drop():
            return
        fields = message.to_dict()
        fields.pop("mavpackettype")
        self.received.append(Received(self._now_s, name, fields))
        ours = fields.get("target_system", 0) in {0, self.vehicle.settings.system}
        ours = ours and fields.get("target_component", 0) in {0, _COMPONENT}
        handler = self._handlers.get(name)
        if ours and handler is not None:
            handler(address, message)

    def _on_heartbeat(self, address: Address, message: Any) -> None:
        del address
        if message.type == _GROUND_STATION:
            self.vehicle.firmware.ground_station_beat(message.get_srcSystem())

    # --- commands -----------------------------------------------------------------------------------------

    def _on_command_long(self, address: Address, message: Any) -> None:
        self._on_command(address, message, [getattr(message, f"param{i}") for i in range(1, 8)])

    def _on_command_int(self, address: Address, message: Any) -> None:
        first = [getattr(message, f"param{i}") for i in range(1, 5)]
        self._on_command(address, message, [*first, float(message.x), float(message.y), message.z])

    def _on_command(self, address: Address, message: Any, params: list[float]) -> None:
        command = int(message.command)
        reply: Message = None
        if command == _REBOOT:
            result: int | None = self._reboot_result(params)
        elif command == _SET_MESSAGE_INTERVAL:
            result = self._set_interval(address, whole(params[0]), params[1])
        elif command == _REQUEST_MESSAGE:
            tell = TELEMETRY.get(whole(params[0]))
            reply = None if tell is None else tell(self._outbox.report(self._now_s))
            result = FAILED if reply is None else ACCEPTED
        else:
            a, b, c, d, e, f, g = params
            result = self.vehicle.firmware.command(command, (a, b, c, d, e, f, g))
        if result is not None:
            self._acknowledge(address, message, command, result)
        self._outbox.send(address, reply)
        if command == _REBOOT and result == ACCEPTED:
            self.vehicle.reboot()
            self._outbox.restart()

    def _acknowledge(self, address: Address, message: Any, command: int, result: int) -> None:
        asker = (message.get_srcSystem(), message.get_srcComponent())
        twice = command == _SET_MODE and self._rng.random() < self.vehicle.firmware.double_ack_rate
        for _ in range(2 if twice else 1):
            self._outbox.send(address, dialect.MAVLink_command_ack_message(command, result, 0, 0, *asker))

    def _set_interval(self, address: Address, number: int, interval_us: float) -> int:
        if number not in TELEMETRY or not math.isfinite(interval_us):
            return FAILED
        self._outbox.set_interval(address, number, interval_us / 1e6, self._now_s)
        return ACCEPTED

    def _on_data_stream(self, address: Address, message: Any) -> None:
        rate_hz = message.req_message_rate if message.start_stop else 0
        for number in _GROUPS.get(message.req_stream_id, ()):
            self._outbox.set_interval(address, number, 1.0 / rate_hz if rate_hz else -1.0, self._now_s)

    def _reboot_result(self, params: list[float]) -> int:
        if params[0] != 1.0:
            return DENIED
        return FAILED if self.vehicle.cockpit.armed else ACCEPTED

    # --- the rest -----------------------------------------------------------------------------------------

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
            mine_ns = self.vehicle.boot_ns(self._now_s)
            self._outbox.send(address, dialect.MAVLink_timesync_message(mine_ns, message.ts1))

    def _on_ping(self, address: Address, message: Any) -> None:
        if message.target_system == 0 and message.target_component == 0:
            asker = (message.get_srcSystem(), message.get_srcComponent())
            self._outbox.send(address, dialect.MAVLink_ping_message(message.time_usec, message.seq, *asker))

    def _send_param(self, address: Address, name: str) -> None:
        params = self.vehicle.cockpit.params
        value, kind, index = params.encode(name), params.kind(name), params.names.index(name)
        message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(params), index)
        self._outbox.send(address, message)

    def _on_param_read(self, address: Address, message: Any) -> None:
        names = self.vehicle.cockpit.params.names
        by_index = names[message.param_index : message.param_index + 1]
        for name in by_index if message.param_index >= 0 else {message.param_id}.intersection(names):
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
