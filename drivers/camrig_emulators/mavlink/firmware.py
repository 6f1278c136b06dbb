"""What a firmware of the emulated drone is to the rest of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

from camrig_emulators.mavlink.dynamics import Demand
from camrig_emulators.mavlink.set_points import SetPoint

CommandParams = tuple[float, float, float, float, float, float, float]


def whole(param: float) -> int:
    """Return a command's parameter as the number it stands for; -1 for NaN and infinity, which stand for none."""
    return int(param) if math.isfinite(param) else -1


class Firmware(Protocol):
    """The habits of one autopilot; ``Cockpit`` tells it what is, ``step`` says what it wants."""

    autopilot: int
    default_streams_hz: Mapping[int, float]
    text_ending: str
    heartbeat_delay_s: float
    """From a change of mode to the extra HEARTBEAT that tells of it."""
    double_ack_rate: float
    """How often DO_SET_MODE is acknowledged twice."""

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT's."""
        ...

    @property
    def mode_name(self) -> str:
        """For a person."""
        ...

    @property
    def modes(self) -> dict[str, int]:
        """All ``custom_mode`` by name, in small letters."""
        ...

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE's MAV_LANDED_STATE."""
        ...

    @property
    def goal(self) -> Demand:
        """What it is flying to."""
        ...

    @property
    def talks(self) -> bool:
        """Whether STATUSTEXTs go out now; they wait otherwise."""
        ...

    def step(self) -> Demand | None:
        """Advance to the cockpit's time; None: rotors stand still."""
        ...

    def command(self, command: int, params: CommandParams) -> int | None:
        """Carry out a COMMAND_LONG; returns the MAV_RESULT, None for no COMMAND_ACK at all."""
        ...

    def set_point(self, point: SetPoint) -> None:
        """Take a set-point, or not; there is never an answer."""
        ...

    def ground_station_beat(self, system: int) -> None:
        """Take note of a ground station's HEARTBEAT."""
        ...

    def parameter_set(self, name: str) -> None:
        """Take note of a parameter that somebody has set."""
        ...

    def change_mode(self, mode: int) -> int:
        """Enter a ``custom_mode``, as a command does; returns the MAV_RESULT."""
        ...
