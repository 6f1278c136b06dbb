"""The parameters of the emulated autopilots, and how each firmware squeezes integers into PARAM_VALUE's float."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass

from camrig_emulators.mavlink.settings import MavlinkDroneSettings

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE


@dataclass(slots=True)
class Param:
    """One parameter: its value and its MAV_PARAM_TYPE."""

    value: float
    kind: int


class Params:
    """A table in the order of its indices.

    ``raw_integers``: PX4 puts an integer's 32 bits into the float field, ArduPilot casts it to a float.
    """

    def __init__(self, table: Mapping[str, tuple[float, int]], *, raw_integers: bool) -> None:
        self._params = {name: Param(value, kind) for name, (value, kind) in table.items()}
        self._raw_integers = raw_integers

    def __getitem__(self, name: str) -> float:
        return self._params[name].value

    def __len__(self) -> int:
        return len(self._params)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, by index."""
        return tuple(self._params)

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
            return float(struct.unpack("<f", struct.pack("<i", int(param.value)))[0])
        return param.value

    def decode(self, name: str, wire: float) -> float:
        """Return the value that PARAM_SET's float carries for a known parameter."""
        if self._raw_integers and self._params[name].kind != REAL32:
            return float(struct.unpack("<i", struct.pack("<f", wire))[0])
        return wire


def ardupilot_params(settings: MavlinkDroneSettings) -> Params:
    """ArduCopter's defaults (4.7 names), with the speeds of the settings."""
    table = {
        "MAV_SYSID": (settings.system, INT16),
        "MAV_GCS_SYSID": (255, INT16),
        "FS_GCS_ENABLE": (0, INT8),
        "FS_GCS_TIMEOUT": (5.0, REAL32),
        "GUID_TIMEOUT": (3.0, REAL32),
        "DISARM_DELAY": (10, INT8),
        "WPNAV_SPEED": (100.0 * settings.max_speed_m_s, REAL32),
        "LAND_SPEED": (100.0 * settings.land_speed_m_s, REAL32),
        "RTL_ALT": (1500.0, REAL32),
        "FENCE_ENABLE": (0, INT8),
        "EK3_SRC1_POSXY": (3, INT8),
        "VISO_TYPE": (0, INT8),
    }
    return Params(table, raw_integers=False)


def px4_params(settings: MavlinkDroneSettings) -> Params:
    """PX4's defaults as its simulation has them, with the speeds of the settings."""
    table = {
        "MAV_SYS_ID": (settings.system, INT32),
        "COM_OF_LOSS_T": (1.0, REAL32),
        "COM_OBL_RC_ACT": (0, INT32),
        "COM_FAIL_ACT_T": (5.0, REAL32),
        "COM_DL_LOSS_T": (10, INT32),
        "COM_DISARM_LAND": (settings.land_disarm_s, REAL32),
        "COM_DISARM_PRFLT": (10.0, REAL32),
        "COM_RC_IN_MODE": (1, INT32),
        "NAV_DLL_ACT": (0, INT32),
        "MIS_TAKEOFF_ALT": (2.5, REAL32),
        "MPC_XY_VEL_MAX": (settings.max_speed_m_s, REAL32),
        "MPC_LAND_SPEED": (settings.land_speed_m_s, REAL32),
        "RTL_RETURN_ALT": (30.0, REAL32),
        "EKF2_EV_CTRL": (0, INT32),
        "EKF2_GPS_CTRL": (7, INT32),
    }
    return Params(table, raw_integers=True)
