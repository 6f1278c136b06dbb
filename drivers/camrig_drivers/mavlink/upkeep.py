"""What is said to an autopilot besides orders: questions, wishes for telemetry, the clock, its origin."""

from __future__ import annotations

from collections.abc import Sequence

from camrig_drivers.mavlink.commands import request_message
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.packets import Command, Heard, ParamValue, Said, SetOrigin, TimeSync
from camrig_drivers.mavlink.parameters import Parameters, rules_of
from camrig_drivers.mavlink.section import VehicleSettings
from camrig_drivers.mavlink.streams import Streams
from camrig_drivers.mavlink.telemetry import Telemetry

_SYNC_S = 1.0
_QUESTION_S = 2.0
_QUESTIONS = 5
_AUTOPILOT_VERSION, _GPS_GLOBAL_ORIGIN = 148, 49


class Upkeep:
    """Streams, parameters, version, clock and origin of one vehicle."""

    def __init__(self, flavour: Flavour, seen: Telemetry, settings: VehicleSettings) -> None:
        self.parameters = Parameters(flavour, rules_of(flavour, vision=settings.needs.vision))
        self._seen = seen
        self._streams = Streams(flavour, settings.stream_hz, gimbal=settings.gimbal)
        self._origin = settings.origin
        self._answers: list[TimeSync] = []
        self._restart_at(float("-inf"))

    def _restart_at(self, now_s: float) -> None:
        self._sync_s = self._question_s = now_s
        self._questions = 0

    def restart(self) -> None:
        """Begin anew: it has rebooted, and forgotten everything."""
        self._streams.restart()
        self.parameters.restart()
        self._restart_at(float("-inf"))

    def hear(self, packet: Heard, now_s: float) -> None:
        """Take one packet that arrived at ``now_s``."""
        self._streams.hear(packet)
        match packet:
            case ParamValue():
                self.parameters.hear(packet)
            case TimeSync(tc1=0, ts1=theirs_ns):
                self._answers.append(TimeSync(round(now_s * 1e9), theirs_ns))

    def due(self, now_s: float) -> list[Said]:
        """Return what to say now."""
        idle = not self._seen.heartbeat.armed
        said: list[Said] = [*self._answers, *self._streams.due(now_s), *self.parameters.due(now_s, idle=idle)]
        self._answers.clear()
        if now_s >= self._sync_s:
            self._sync_s = now_s + _SYNC_S
            said.append(TimeSync(0, round(now_s * 1e9)))
        if now_s >= self._question_s:
            self._question_s = now_s + _QUESTION_S
            said += self._questions_now()
        return said

    def _questions_now(self) -> Sequence[Command | SetOrigin]:
        """Ask for the version, a few times; and for the origin, as long as it takes, for nothing acknowledges it."""
        self._questions += 1
        seen, said = self._seen, []
        if seen.version is None and self._questions <= _QUESTIONS:
            said.append(request_message(_AUTOPILOT_VERSION))
        if self._origin is not None and seen.global_origin is None and seen.position_m is not None:
            if self._questions % 2:
                said.append(request_message(_GPS_GLOBAL_ORIGIN))
            else:
                return [*said, self._origin]
        return said
