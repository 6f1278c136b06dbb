"""What the emulated autopilot does besides flying: parameters, clocks, origin, signing, poses, files, missions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from camrig_emulators.delayed import Address
from camrig_emulators.mavlink.messages_more import gps_global_origin
from camrig_emulators.mavlink.outbox import Outbox
from camrig_emulators.mavlink.vehicle import SigningKey, Vehicle
from camrig_emulators.mavlink.vision import PeerClock, vision_pose

Handler = Callable[[Address, Any], None]

_INFO = 6
_KEY_BYTES = 32
_FTP_NAK, _FTP_FILE_NOT_FOUND, _FTP_NO_SUCH_COMMAND = 129, 10, 7
_FTP_QUIET = (1, 2)  # TerminateSession, ResetSessions: acknowledged
_FTP_OPENS = (3, 4, 14)  # ListDirectory, OpenFileRO, CalcFileCRC32
_FTP_ACK = 128


class Services:
    """Answers on one link. ``now_s`` is set by the protocol before every message."""

    def __init__(self, vehicle: Vehicle, outbox: Outbox) -> None:
        self.now_s = vehicle.history.latest.stamp_s
        self._vehicle = vehicle
        self._outbox = outbox
        self._clock = PeerClock()
        self._clock_boots = vehicle.boots
        self.handlers: dict[str, Handler] = {
            "TIMESYNC": self._on_timesync,
            "PING": self._on_ping,
            "PARAM_REQUEST_READ": self._on_param_read,
            "PARAM_REQUEST_LIST": self._on_param_list,
            "PARAM_SET": self._on_param_set,
            "SET_GPS_GLOBAL_ORIGIN": self._on_origin,
            "SETUP_SIGNING": self._on_signing,
            "VISION_POSITION_ESTIMATE": self._on_pose,
            "ODOMETRY": self._on_pose,
            "FILE_TRANSFER_PROTOCOL": self._on_file,
            "MISSION_REQUEST_LIST": self._on_mission_list,
        }

    # --- clocks -------------------------------------------------------------------------------------------

    def _on_timesync(self, address: Address, message: Any) -> None:
        mine_ns = self._vehicle.boot_ns(self.now_s)
        if message.tc1 == 0:
            self._outbox.send(address, dialect.MAVLink_timesync_message(mine_ns, message.ts1))
        else:
            self._peer_clock().answered(message.tc1, message.ts1, mine_ns)

    def _peer_clock(self) -> PeerClock:
        if self._clock_boots != self._vehicle.boots:
            self._clock, self._clock_boots = PeerClock(), self._vehicle.boots
        return self._clock

    def _on_ping(self, address: Address, message: Any) -> None:
        if message.target_system == 0 and message.target_component == 0:
            asker = (message.get_srcSystem(), message.get_srcComponent())
            self._outbox.send(address, dialect.MAVLink_ping_message(message.time_usec, message.seq, *asker))

    # --- parameters ---------------------------------------------------------------------------------------

    def _send_param(self, address: Address, name: str) -> None:
        params = self._vehicle.params
        value, kind, index = params.encode(name), params.kind(name), params.names.index(name)
        message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(params), index)
        self._outbox.send(address, message)

    def _on_param_read(self, address: Address, message: Any) -> None:
        names = self._vehicle.params.names
        by_index = names[message.param_index : message.param_index + 1]
        for name in by_index if message.param_index >= 0 else {message.param_id}.intersection(names):
            self._send_param(address, name)

    def _on_param_list(self, address: Address, message: Any) -> None:
        del message
        for name in self._vehicle.params.names:
            self._send_param(address, name)

    def _on_param_set(self, address: Address, message: Any) -> None:
        params, name = self._vehicle.params, message.param_id
        if name not in params.names:
            return
        value = params.decode(name, message.param_value)
        changed = value != params[name]
        params.set(name, value)
        if changed:
            self._vehicle.firmware.parameter_set(name)
        self._send_param(address, name)

    # --- poses --------------------------------------------------------------------------------------------

    def _on_pose(self, address: Address, message: Any) -> None:
        del address
        pose = vision_pose(message, self._vehicle, self._peer_clock(), self.now_s)
        if pose is not None:
            self._vehicle.cockpit.estimator.see(pose)

    def _on_origin(self, address: Address, message: Any) -> None:
        """ArduPilot takes an origin once; PX4 also later, if its system id is named. Neither acknowledges."""
        vehicle = self._vehicle
        px4 = vehicle.settings.flavour == "px4"
        if px4 and message.target_system != vehicle.settings.system:
            return
        new = vehicle.cockpit.tell_origin(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
        if not (new or px4):
            return
        if not px4:
            vehicle.cockpit.say(_INFO, "EKF3 IMU0 origin set")
        self._outbox.send(address, gps_global_origin(self._outbox.report(self.now_s)))

    # --- the rest -----------------------------------------------------------------------------------------

    def _on_signing(self, address: Address, message: Any) -> None:
        """Only ArduPilot knows it, and never acknowledges. A key and a time of zero end it."""
        del address
        if self._vehicle.settings.flavour != "ardupilot":
            return
        key = bytes(message.secret_key[:_KEY_BYTES])
        ended = not any(key) and message.initial_timestamp == 0
        self._vehicle.signing = None if ended else SigningKey(key, message.initial_timestamp, self.now_s)

    def _on_file(self, address: Address, message: Any) -> None:
        """There are no files: ground stations fall back on asking for parameters one by one."""
        payload = bytearray(bytes(message.payload))
        opcode = payload[3]
        answer = bytearray(len(payload))
        sequence = (int.from_bytes(payload[0:2], "little") + 1) & 0xFFFF
        answer[0:2], answer[2], answer[5] = sequence.to_bytes(2, "little"), payload[2], opcode
        if opcode in _FTP_QUIET:
            answer[3] = _FTP_ACK
        else:
            reason = _FTP_FILE_NOT_FOUND if opcode in _FTP_OPENS else _FTP_NO_SUCH_COMMAND
            answer[3], answer[4], answer[12] = _FTP_NAK, 1, reason
        asker = (message.get_srcSystem(), message.get_srcComponent())
        self._outbox.send(address, dialect.MAVLink_file_transfer_protocol_message(0, *asker, answer))

    def _on_mission_list(self, address: Address, message: Any) -> None:
        """There is no mission, no fence of points, no rally point."""
        asker = (message.get_srcSystem(), message.get_srcComponent())
        self._outbox.send(address, dialect.MAVLink_mission_count_message(*asker, 0, message.mission_type))
