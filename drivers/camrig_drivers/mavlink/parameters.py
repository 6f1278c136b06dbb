"""Which parameters an autopilot must have before it may fly in a rig, and asking it for them.

Read only: camrig writes no parameter. The failsafes are what brings a drone down when camrig, its host or its link is
gone; none of them may climb or fly home through a room.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.packets import OWN_SYSTEM, ParamRead, ParamValue

_ASK_S = 0.4
_BATCH = 6
"""Questions at once: a telemetry radio carries no more beside the streams."""
_PATIENCE = 5
"""Questions without an answer after which a parameter counts as not there."""
_REFRESH_S = 10.0
_REAL32 = 9


@dataclass(frozen=True, slots=True)
class Rule:
    """One parameter under its names, newest version first; ``needed``: without it arming is refused."""

    names: tuple[str, ...]
    fits: Callable[[float], bool]
    wanted: str
    why: str
    needed: bool = True


def _is(*values: float) -> Callable[[float], bool]:
    return lambda value: value in values


def _at_most(limit: float) -> Callable[[float], bool]:
    return lambda value: 0.0 < value <= limit


def _bits(mask: int) -> Callable[[float], bool]:
    return lambda value: math.isfinite(value) and int(value) & mask == mask


_ARDUPILOT = (
    Rule(("FS_GCS_ENABLE",), _is(5), "5 (land)", "what it does when camrig is gone"),
    Rule(("FS_GCS_TIMEOUT",), _at_most(5.0), "at most 5 s", "when it does it", needed=False),
    Rule(("GUID_TIMEOUT",), _at_most(1.0), "at most 1 s", "how long it obeys a last velocity"),
    Rule(("MAV_GCS_SYSID", "SYSID_MYGCS"), _is(OWN_SYSTEM), f"{OWN_SYSTEM} (camrig)", "whose heartbeats it counts"),
    Rule(("FS_EKF_ACTION",), _is(1, 3), "1 (land)", "what it does when its estimator fails", needed=False),
    Rule(
        ("FS_THR_ENABLE",), _is(0, 3), "0 (off) or 3 (land)", "losing a remote control means going home", needed=False
    ),
    Rule(("BATT_FS_LOW_ACT",), _is(0, 1), "0 (none) or 1 (land)", "a low battery means going home", needed=False),
    Rule(("FENCE_ENABLE",), _is(1), "1, with FENCE_ALT_MAX above box_m", "a fence of its own", needed=False),
    Rule(("FENCE_ACTION",), _is(0, 2, 4), "2 (land) or 4 (brake)", "a breach means going home", needed=False),
)
_ARDUPILOT_VISION = (
    Rule(("GPS1_TYPE", "GPS_TYPE"), _is(0), "0 (none)", "pose: vision flies without GPS"),
    Rule(("VISO_TYPE",), _is(1), "1 (MAVLink)", "takes poses from camrig"),
    Rule(("EK3_SRC1_POSXY",), _is(6), "6 (external)", "estimator source"),
    Rule(("EK3_SRC1_POSZ",), _is(1, 6), "6 (external) or 1 (barometer)", "estimator source"),
    Rule(("EK3_SRC1_YAW",), _is(6), "6 (external)", "camrig's north is the world's y, a compass has another"),
    Rule(("EK3_SRC1_VELXY",), _is(0, 6), "0 (none)", "estimator source"),
    Rule(("EK3_SRC1_VELZ",), _is(0, 6), "0 (none)", "estimator source"),
    Rule(("COMPASS_ENABLE",), _is(0), "0", "a compass indoors disturbs the yaw", needed=False),
)
_PX4 = (
    Rule(
        ("COM_OBL_RC_ACT",), _is(4, 5), "4 (land) or 5 (hold)", "what it does when set-points end; 0 climbs and returns"
    ),
    Rule(("NAV_DLL_ACT",), _is(1, 3), "3 (land) or 1 (hold)", "what it does when camrig is gone"),
    Rule(
        ("COM_OF_LOSS_T",), _is(1.0), "1 s", "when it misses set-points; camrig then sends no more, or it would resume"
    ),
    Rule(("NAV_RCL_ACT",), _is(1, 3), "3 (land) or 1 (hold)", "losing a remote control means going home", needed=False),
    Rule(("COM_LOW_BAT_ACT",), _is(0, 2), "0 (warn) or 2 (land)", "a low battery means going home", needed=False),
    Rule(("GF_ACTION",), _is(0, 1, 2, 5), "2 (hold) or 5 (land)", "a breach means going home", needed=False),
)
_PX4_VISION = (
    Rule(("SYS_HAS_GPS",), _is(0), "0", "pose: vision flies without GPS"),
    Rule(("EKF2_GPS_CTRL",), _is(0), "0 (none)", "pose: vision flies without GPS"),
    Rule(("EKF2_EV_CTRL",), _bits(11), "11 (position, height and yaw)", "takes poses from camrig"),
    Rule(("EKF2_HGT_REF",), _is(3), "3 (vision)", "height of the rig, not of a barometer"),
    Rule(("EKF2_MAG_TYPE",), _is(5), "5 (none)", "camrig's north is the world's y, a compass has another"),
)


def rules_of(flavour: Flavour, *, vision: bool) -> tuple[Rule, ...]:
    """Return what an autopilot of this flavour must have; ``vision``: it flies by poses from camrig."""
    if flavour.raw_integers:
        return _PX4 + (_PX4_VISION if vision else ())
    return _ARDUPILOT + (_ARDUPILOT_VISION if vision else ())


def value_of(packet: ParamValue, *, raw_integers: bool) -> float:
    """Return the value that PARAM_VALUE stands for: PX4 puts an integer's bits into the float, ArduPilot casts it."""
    if raw_integers and packet.kind != _REAL32:
        return float(struct.unpack("<i", struct.pack("<f", packet.wire))[0])
    return packet.wire


class Parameters:
    """What is known of one autopilot's parameters, and the questions that are still to be asked."""

    def __init__(self, flavour: Flavour, rules: Sequence[Rule]) -> None:
        self._raw_integers = flavour.raw_integers
        self._rules = rules
        self._values: dict[str, float] = {}
        self._names = tuple(name for rule in rules for name in rule.names)
        self._asked = dict.fromkeys(self._names, 0)
        self._queue = list(self._names)
        self._next_s = float("-inf")
        self._again_s = float("inf")

    def hear(self, packet: ParamValue) -> None:
        """Take a value, asked for or told because somebody has changed it."""
        if packet.name in self._asked:
            self._values[packet.name] = value_of(packet, raw_integers=self._raw_integers)

    def restart(self) -> None:
        """Forget all of them and ask again."""
        self._values.clear()
        self._asked = dict.fromkeys(self._names, 0)
        self._queue = list(self._names)
        self._next_s = float("-inf")

    def due(self, now_s: float, *, idle: bool) -> list[ParamRead]:
        """Return the questions to ask now; while it is ``idle`` all are asked again now and then."""
        if now_s < self._next_s:
            return []
        self._next_s = now_s + _ASK_S
        if not self._queue:
            self._queue = [name for name in self._names if name not in self._values and self._asked[name] < _PATIENCE]
        if not self._queue and idle and now_s >= self._again_s:
            self._queue = list(self._names)
        if not self._queue:
            return []
        self._again_s = now_s + _REFRESH_S
        batch, self._queue = self._queue[:_BATCH], self._queue[_BATCH:]
        for name in batch:
            self._asked[name] += 1
        return [ParamRead(name) for name in batch]

    @property
    def complete(self) -> bool:
        """Whether every parameter is known, or is known not to be there."""
        return all(self._known(rule) is not None or not self._pending(rule) for rule in self._rules)

    def mismatches(self, *, needed: bool) -> Iterator[str]:
        """Yield every parameter that is not as wanted: its name, what was found, and what to set."""
        for rule in self._rules:
            if rule.needed != needed:
                continue
            found = self._known(rule)
            if found is None:
                if needed:
                    told = "is not read yet" if self._pending(rule) else "is not told"
                    yield f"parameter {' or '.join(rule.names)} {told}, {rule.wanted} is wanted ({rule.why})"
            elif not rule.fits(found[1]):
                name, value = found
                yield f"parameter {name} is {value:g}, set it to {rule.wanted} ({rule.why})"

    def _known(self, rule: Rule) -> tuple[str, float] | None:
        return next(((name, self._values[name]) for name in rule.names if name in self._values), None)

    def _pending(self, rule: Rule) -> bool:
        return any(self._asked[name] < _PATIENCE for name in rule.names)
