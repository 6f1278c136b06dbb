"""One axis of a UVC head: between its control, in seconds of arc and steps, and our radians, within its limits."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from camrig.errors import HardwareError, InputError
from camrig.rig import Interval
from camrig_drivers.limits import check_within
from camrig_drivers.uvc.section import UvcAxisSection
from camrig_drivers.v4l2.node import ControlInfo

_ARC_SECONDS = 3600.0
"""V4L2_CID_PAN_ABSOLUTE and V4L2_CID_TILT_ABSOLUTE: "the unit is arc seconds"."""


@dataclass(frozen=True, slots=True)
class Axis:
    """How one axis counts, and what its device can do."""

    name: Literal["pan", "tilt"]
    section: UvcAxisSection
    limits_rad: Interval
    control: ControlInfo
    readback_sigma_deg: float

    def value(self, angle_rad: float) -> int:
        """Return the control's value nearest to an angle and not beyond a limit; InputError outside (or for NaN)."""
        check_within(self.name, angle_rad, self.limits_rad)
        ends = sorted(map(self._steps, self.limits_rad))
        lowest, highest = math.ceil(ends[0] - 1e-6), math.floor(ends[1] + 1e-6)
        return self.control.minimum + self._step * min(max(round(self._steps(angle_rad)), lowest), highest)

    def nearest(self, angle_rad: float) -> int:
        """Return the control's value nearest to where the axis is: beyond a limit only if the axis is."""
        with suppress(InputError):
            return self.value(angle_rad)
        last = (self.control.maximum - self.control.minimum) // self._step
        return self.control.minimum + self._step * min(max(round(self._steps(angle_rad)), 0), last)

    def angle_rad(self, value: int) -> float:
        """Return the angle of a value."""
        return math.radians(self.section.sign * value / _ARC_SECONDS + self.section.offset_deg)

    @property
    def step_rad(self) -> float:
        """The angle from one value to the next."""
        return math.radians(self._step / _ARC_SECONDS)

    @property
    def sigma_rad(self) -> float:
        """One sigma of a report: its step and the play are uniform, so their width over sqrt(12) counts."""
        step_deg = self._step / _ARC_SECONDS / math.sqrt(12.0)
        play_deg = self.section.backlash_deg / math.sqrt(12.0)
        return math.radians(math.hypot(step_deg, play_deg, self.readback_sigma_deg))

    def check_limits(self, label: str) -> None:
        """Raise HardwareError where the rig's limits reach beyond what the device can do."""
        slack_rad = self.step_rad
        ends = sorted(map(self.angle_rad, (self.control.minimum, self.control.maximum)))
        if self.limits_rad[0] < ends[0] - slack_rad or self.limits_rad[1] > ends[1] + slack_rad:
            can, asked = (f"{math.degrees(low):g} to {math.degrees(high):g}" for low, high in (ends, self.limits_rad))
            raise HardwareError(
                f"{label} moves its {self.name} from {can} deg, and {self.name}_deg {asked} reaches beyond; narrow it"
            )

    @property
    def _step(self) -> int:
        return max(1, self.control.step)

    def _steps(self, angle_rad: float) -> float:
        value = self.section.sign * (math.degrees(angle_rad) - self.section.offset_deg) * _ARC_SECONDS
        return (value - self.control.minimum) / self._step
