"""What the emulated drone makes of the MAVLink it hears: stamps and datagrams in, datagrams out; no socket."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.delayed import Address, Datagram
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.cockpit import ACCEPTED, DENIED, FAILED
from camrig_emulators.mavlink.commands import Cmd
from camrig_emulators.mavlink.firmware import whole
from camrig_emulators.mavlink.messages import Message
from camrig_emulators.mavlink.messages_more import MESSAGES
from camrig_emulators.mavlink.outbox import Outbox
from camrig_emulators.mavlink.services import Services
from camrig_emulators.mavlink.set_points import SetPoint
from camrig_emulators.mavlink.streams import GROUPS
from camrig_emulators.mavlink.vehicle import Vehicle

_COMPONENT = 1
KEPT_RECEIVED = 50_000
_GROUND_STATION = 6  # MAV_TYPE_GCS
_HOME_POSITION = 242
_DROPPABLE = {"COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_LOCAL_NED"}


@dataclass(frozen=True, slots=True)
class Received:
    """One message that the drone heard."""

    stamp_s: float
    name: str
    fields: dict[str, Any]


class MavlinkProtocol:
    """One vehicle on one link. Every call brings the vehicle up to ``now_s`` and returns datagrams to send.

    Several links of one vehicle may share what they ``received``. ``channel`` 0 is the one that needs no signature.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        faults: Faults,
        seed: int,
        target: Address | None = None,
        *,
        channel: int = 1,
        received: deque[Received] | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.received: deque[Received] = deque(maxlen=KEPT_RECEIVED) if received is None else received
        self._faults = faults
        self._outbox = Outbox(vehicle, faults, channel)
        self._services = Services(vehicle, self._outbox)
        self._rng = np.random.default_rng([seed, vehicle.settings.system, 2])
        self._now_s = vehicle.history.latest.stamp_s
        self._handlers: dict[str, Callable[[Address, Any], None]] = {
            **self._services.handlers,
            "HEARTBEAT": self._on_heartbeat,
            "COMMAND_LONG": self._on_command_long,
            "COMMAND_INT": self._on_command_int,
            "SET_MODE": self._on_set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._on_set_point,
            "REQUEST_DATA_STREAM": self._on_data_stream,
        }
        if target is not None:
            self._outbox.keep(target, self._now_s)

    @property
    def boots(self) -> int:
        """How often the vehicle has started."""
        return self.vehicle.boots

    def attach(self, now_s: float, address: Address) -> None:
        """Talk to this address until ``detach``."""
        self._outbox.keep(address, now_s)

    def detach(self, address: Address) -> None:
        """Forget an address."""
        self._outbox.forget(address)

    def receive(self, now_s: float, address: Address, data: bytes) -> list[Datagram]:
        """Take what one datagram or stream brought; an autopilot that boots hears nothing."""
        self._advance(now_s)
        if now_s < self.vehicle.silent_until_s:
            return self._outbox.flush()
        peer = self._outbox.peer(address, now_s)
        peer.heard_s = now_s
        for message in peer.mav.parse_buffer(data) or ():
            self._take(address, message)
        return self.poll(now_s)

    def poll(self, now_s: float) -> list[Datagram]:
        """Send what is due."""
        self._advance(now_s)
        if now_s >= self.vehicle.silent_until_s:
            self._outbox.collect(now_s)
        return self._outbox.flush()

    def next_due_s(self, now_s: float) -> float:
        """Return when ``poll`` will have something to send, as far as that is known."""
        return max(self.vehicle.silent_until_s, self._outbox.next_due_s(now_s))

    def listeners(self, now_s: float) -> int:
        """Return how many get telemetry."""
        return len(self._outbox.listeners(now_s))

    def make_noise(self, noise: bytes) -> None:
        """Send bytes that are no message before the next ones."""
        self._outbox.make_noise(noise)

    def _advance(self, now_s: float) -> None:
        self._now_s = self._services.now_s = now_s
        self.vehicle.advance_to(now_s)
        self._outbox.catch_up(now_s)

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
        match command:
            case Cmd.REBOOT:
                result: int | None = self._reboot_result(params)
            case Cmd.SET_MESSAGE_INTERVAL:
                result = self._set_interval(address, whole(params[0]), params[1])
            case Cmd.GET_MESSAGE_INTERVAL:
                interval_us = min(2.0**31 - 1.0, 1e6 * self._outbox.interval_s(address, whole(params[0])))
                reply = dialect.MAVLink_message_interval_message(whole(params[0]) & 0xFFFF, max(-1, round(interval_us)))
                result = ACCEPTED
            case Cmd.REQUEST_MESSAGE | Cmd.GET_HOME_POSITION:
                reply = self._telemetry(_HOME_POSITION if command == Cmd.GET_HOME_POSITION else whole(params[0]))
                result = FAILED if reply is None else ACCEPTED
            case _:
                a, b, c, d, e, f, g = params
                result = self.vehicle.firmware.command(command, (a, b, c, d, e, f, g))
        if result is not None:
            self._acknowledge(address, message, command, result)
        self._outbox.send(address, reply)
        if command == Cmd.REBOOT and result == ACCEPTED:
            self.vehicle.reboot()

    def _telemetry(self, number: int) -> Message:
        tell = MESSAGES[self.vehicle.firmware.autopilot].get(number)
        return None if tell is None else tell(self._outbox.report(self._now_s))

    def _acknowledge(self, address: Address, message: Any, command: int, result: int) -> None:
        asker = (message.get_srcSystem(), message.get_srcComponent())
        twice = command == Cmd.SET_MODE and self._rng.random() < self.vehicle.firmware.double_ack_rate
        for _ in range(2 if twice else 1):
            self._outbox.send(address, dialect.MAVLink_command_ack_message(command, result, 0, 0, *asker))

    def _on_set_mode(self, address: Address, message: Any) -> None:
        """Take the old message for a change of mode, which nobody acknowledges."""
        del address
        self.vehicle.firmware.change_mode(message.custom_mode)

    def _set_interval(self, address: Address, number: int, interval_us: float) -> int:
        if number not in MESSAGES[self.vehicle.firmware.autopilot] or not math.isfinite(interval_us):
            return FAILED
        self._outbox.set_interval(address, number, interval_us / 1e6, self._now_s)
        return ACCEPTED

    def _on_data_stream(self, address: Address, message: Any) -> None:
        rate_hz = message.req_message_rate if message.start_stop else 0
        spoken = MESSAGES[self.vehicle.firmware.autopilot]
        for number in spoken.keys() & set(GROUPS.get(message.req_stream_id, ())):
            self._outbox.set_interval(address, number, 1.0 / rate_hz if rate_hz else -1.0, self._now_s)

    def _reboot_result(self, params: list[float]) -> int:
        if params[0] != 1.0:
            return DENIED
        return FAILED if self.vehicle.cockpit.armed else ACCEPTED

    def _on_set_point(self, address: Address, message: Any) -> None:
        del address
        self.vehicle.firmware.set_point(
            SetPoint(
                coordinate_frame=message.coordinate_frame,
                type_mask=message.type_mask,
                position=np.array([message.x, message.y, message.z], dtype=float),
                velocity=np.array([message.vx, message.vy, message.vz], dtype=float),
                acceleration=np.array([message.afx, message.afy, message.afz], dtype=float),
                yaw_rad=message.yaw,
                yaw_rate_rad_s=message.yaw_rate,
            )
        )
