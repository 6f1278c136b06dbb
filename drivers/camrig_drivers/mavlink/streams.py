"""Asks for the messages we need and goes on asking while they do not come as often as they should.

Heals a lost request, a reboot (ArduPilot forgets its intervals) and a ground station that set other rates, alike.
"""

from __future__ import annotations

from collections import Counter

from camrig_drivers.mavlink.commands import message_interval
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.packets import (
    Attitude,
    Command,
    Estimator,
    ExtendedState,
    GimbalAttitude,
    Heard,
    LocalPosition,
    SystemStatus,
)

_WINDOW_S = 2.0
_ENOUGH = 0.5
"""Of the messages asked for; below this share they are asked for again."""


class Streams:
    """The streams of one vehicle."""

    def __init__(self, flavour: Flavour, pose_hz: float, *, gimbal: bool = False) -> None:
        self._wanted: dict[type[Heard], tuple[int, float]] = {
            Attitude: (30, pose_hz),
            LocalPosition: (32, pose_hz),
            ExtendedState: (245, 5.0),
            SystemStatus: (1, 2.0),
            Estimator: (flavour.estimator_message, 5.0),
        }
        if gimbal:
            self._wanted[GimbalAttitude] = (285, 10.0)
        self._heard: Counter[type[Heard]] = Counter()
        self._next_look_s = float("-inf")

    def hear(self, packet: Heard) -> None:
        """Count one message."""
        self._heard[type(packet)] += 1

    def restart(self) -> None:
        """Ask for everything at the next look, which is now."""
        self._heard.clear()
        self._next_look_s = float("-inf")

    def due(self, now_s: float) -> list[Command]:
        """Return the requests to send now."""
        if now_s < self._next_look_s:
            return []
        self._next_look_s = now_s + _WINDOW_S
        missing = [
            message_interval(message_id, rate_hz)
            for kind, (message_id, rate_hz) in self._wanted.items()
            if self._heard[kind] < _ENOUGH * rate_hz * _WINDOW_S
        ]
        self._heard.clear()
        return missing
