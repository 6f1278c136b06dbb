"""The parameters of the emulated autopilots, and how each firmware squeezes integers into PARAM_VALUE's float."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE

RELEASES: dict[str, tuple[str, ...]] = {"ardupilot": ("4.5", "4.6", "4.7"), "px4": ("1.17",)}
"""Emulated, oldest first."""

Table = Mapping[str, tuple[float, int]]

_ARDUPILOT: Table = {
    "MAV_SYSID": (1, INT16),
    "MAV_GCS_SYSID": (255, INT16),
    "FS_GCS_ENABLE": (0, INT8),
    "FS_GCS_TIMEOUT": (5.0, REAL32),
    "FS_EKF_ACTION": (1, INT8),
    "FS_EKF_THRESH": (0.8, REAL32),
    "GUID_TIMEOUT": (3.0, REAL32),
    "GUID_OPTIONS": (0, INT32),
    "DISARM_DELAY": (10, INT8),
    "WPNAV_SPEED": (1000.0, REAL32),
    "LAND_SPEED": (50.0, REAL32),
    "RTL_ALT": (1500.0, REAL32),
    "FENCE_ENABLE": (0, INT8),
    "FENCE_TYPE": (7, INT8),
    "FENCE_ACTION": (1, INT8),
    "FENCE_ALT_MAX": (100.0, REAL32),
    "FENCE_RADIUS": (300.0, REAL32),
    "BATT_MONITOR": (4, INT8),
    "BATT_LOW_MAH": (0.0, REAL32),
    "BATT_CRT_MAH": (0.0, REAL32),
    "BATT_CAPACITY": (3300, INT32),
    "BATT_FS_LOW_ACT": (0, INT8),
    "BATT_FS_CRT_ACT": (0, INT8),
    "GPS1_TYPE": (1, INT8),
    "COMPASS_ENABLE": (1, INT8),
    "EK3_SRC1_POSXY": (3, INT8),
    "EK3_SRC1_POSZ": (1, INT8),
    "EK3_SRC1_VELXY": (3, INT8),
    "EK3_SRC1_VELZ": (3, INT8),
    "EK3_SRC1_YAW": (1, INT8),
    "VISO_TYPE": (0, INT8),
    "VISO_DELAY_MS": (10, INT16),
    "MNT1_TYPE": (0, INT8),
    "MNT1_PITCH_MIN": (-90.0, REAL32),
    "MNT1_PITCH_MAX": (20.0, REAL32),
}

_PX4: Table = {
    "MAV_SYS_ID": (1, INT32),
    "COM_OF_LOSS_T": (1.0, REAL32),
    "COM_OBL_RC_ACT": (0, INT32),
    "COM_FAIL_ACT_T": (5.0, REAL32),
    "COM_DL_LOSS_T": (10, INT32),
    "COM_DISARM_LAND": (2.0, REAL32),
    "COM_DISARM_PRFLT": (10.0, REAL32),
    "COM_RC_IN_MODE": (1, INT32),
    "COM_LOW_BAT_ACT": (0, INT32),
    "BAT_LOW_THR": (0.15, REAL32),
    "BAT_CRIT_THR": (0.07, REAL32),
    "NAV_DLL_ACT": (0, INT32),
    "MIS_TAKEOFF_ALT": (2.5, REAL32),
    "MPC_XY_VEL_MAX": (12.0, REAL32),
    "MPC_LAND_SPEED": (0.7, REAL32),
    "RTL_RETURN_ALT": (30.0, REAL32),
    "GF_ACTION": (2, INT32),
    "GF_MAX_HOR_DIST": (0.0, REAL32),
    "GF_MAX_VER_DIST": (0.0, REAL32),
    "SYS_HAS_GPS": (1, INT32),
    "EKF2_EV_CTRL": (0, INT32),
    "EKF2_EV_DELAY": (0.0, REAL32),
    "EKF2_GPS_CTRL": (7, INT32),
    "EKF2_HGT_REF": (1, INT32),
    "EKF2_MAG_TYPE": (0, INT32),
    "MNT_MODE_IN": (-1, INT32),
    "MNT_MODE_OUT": (0, INT32),
}

_BEFORE_4_7 = {"MAV_SYSID": "SYSID_THISMAV", "MAV_GCS_SYSID": "SYSID_MYGCS"}
_BEFORE_4_6 = {**_BEFORE_4_7, "GPS1_TYPE": "GPS_TYPE"}
_OLD_NAMES: dict[str, dict[str, str]] = {"4.5": _BEFORE_4_6, "4.6": _BEFORE_4_7}

PARAMETERS_OF: dict[tuple[str, str], Table] = {
    ("px4", "1.17"): _PX4,
    **{
        ("ardupilot", release): {_OLD_NAMES.get(release, {}).get(name, name): kept for name, kept in _ARDUPILOT.items()}
        for release in RELEASES["ardupilot"]
    },
}
"""Names, defaults and types by flavour and release."""


@dataclass(slots=True)
class Param:
    """One parameter: its value and its MAV_PARAM_TYPE."""

    value: float
    kind: int


class Params:
    """One vehicle's table, in the order of its indices; it outlives a reboot.

    ``values`` differ from the defaults. PX4 puts an integer's 32 bits into the float field, ArduPilot casts it to a
    float. Emulated firmware reads by the newest names, whatever the release calls them.
    """

    def __init__(self, flavour: str, release: str | None, values: Mapping[str, float]) -> None:
        release = release or RELEASES[flavour][-1]
        self._alias = _OLD_NAMES.get(release, {})
        self._raw_integers = flavour == "px4"
        self._params = {name: Param(value, kind) for name, (value, kind) in PARAMETERS_OF[flavour, release].items()}
        for name, value in values.items():
            self.set(self._alias.get(name, name), value)

    def __getitem__(self, name: str) -> float:
        return self._params[self._alias.get(name, name)].value

    def __len__(self) -> int:
        return len(self._params)

    @property
    def names(self) -> tuple[str, ...]:
        """All names of this release, by index."""
        return tuple(self._params)

    def snapshot(self) -> dict[str, float]:
        """Return all values by the newest names."""
        newest = {old: new for new, old in self._alias.items()}
        return {newest.get(name, name): param.value for name, param in self._params.items()}

    def kind(self, name: str) -> int:
        """Return a parameter's MAV_PARAM_TYPE."""
        return self._params[name].kind

    def set(self, name: str, value: float) -> None:
        """Give a known parameter a value; integers are rounded, what is no number is left out."""
        param = self._params[name]
        if math.isfinite(value):
            param.value = value if param.kind == REAL32 else float(round(value))

    def encode(self, name: str) -> float:
        """Return the value as PARAM_VALUE carries it."""
        param = self._params[name]
        if self._raw_integers and param.kind != REAL32:
            return float(struct.unpack("<f", struct.pack("<i", _int32(param.value)))[0])
        return param.value

    def decode(self, name: str, wire: float) -> float:
        """Return the value that PARAM_SET's float carries for a known parameter."""
        if self._raw_integers and self._params[name].kind != REAL32:
            return float(struct.unpack("<i", struct.pack("<f", wire))[0])
        return wire


def _int32(value: float) -> int:
    return int(max(-(2.0**31), min(2.0**31 - 1.0, value)))
