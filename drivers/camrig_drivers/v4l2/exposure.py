"""An exposure that keeps motion sharp: as long as the blur allows, then as much gain as there is, and no more.

A device's own automatic exposure goes on to exposures of a whole frame in a dim room, and every moving tag is smeared.
Here the longest exposure follows from how fast things cross the picture; where light is then missing, that is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from camrig.errors import HardwareError
from camrig.geometry.arrays import GreyImage
from camrig_drivers.v4l2 import abi
from camrig_drivers.v4l2.controls import find_control, set_control
from camrig_drivers.v4l2.locks import CID_EXPOSURE_ABSOLUTE, CID_GAIN, to_seconds, to_units
from camrig_drivers.v4l2.node import ControlInfo, Node
from camrig_drivers.v4l2.section import BlurLimit

SETTLE_FRAMES = 4
"""A changed exposure shows in the picture some frames later; judged sooner, it would be changed twice."""
_SAMPLED = 16
"""Every so many rows and columns are looked at."""
_BRIGHT_PERCENTILE = 90.0
"""What must be neither dark nor burnt out: the white of the tags, not the mean of the room."""
_DEAD_BAND = 0.2
_DARK = 0.5
_BURNT_OUT = 1.6
_WHITE = 250.0
_MOST_AT_ONCE = 2.0
_GAIN_STEPS = 32


@dataclass(frozen=True, slots=True)
class Range:
    """What a control may be."""

    low: int
    high: int
    step: int = 1

    def clip(self, value: float) -> int:
        """Return the nearest allowed value that is not above ``value``, or the lowest."""
        steps = math.floor((min(value, self.high) - self.low) / self.step)
        return self.low + max(0, steps) * self.step


@dataclass(frozen=True, slots=True)
class Setting:
    """Exposure in units of 100 us, and gain as the device counts it."""

    exposure: int
    gain: int


@dataclass(frozen=True, slots=True)
class Policy:
    """Chooses the next setting; pure."""

    exposure: Range
    gain: Range
    brightness: float

    def first(self) -> Setting:
        """Return where to start: all the light that the blur allows, and no gain, which is noise."""
        return Setting(self.exposure.high, self.gain.low)

    def after(self, setting: Setting, bright: float) -> Setting:
        """Return the setting to follow one that gave this brightness: gain goes up last and down first."""
        ratio = self.brightness / max(bright, 1.0)
        if abs(ratio - 1.0) <= _DEAD_BAND:
            return setting
        gain_step = max(self.gain.step, (self.gain.high - self.gain.low) // _GAIN_STEPS)
        if ratio > 1.0 and setting.exposure >= self.exposure.high:
            return replace(setting, gain=self.gain.clip(setting.gain + gain_step))
        if ratio < 1.0 and setting.gain > self.gain.low:
            return replace(setting, gain=self.gain.clip(setting.gain - gain_step))
        return replace(setting, exposure=self._exposure_after(setting.exposure, ratio))

    def _exposure_after(self, exposure: int, ratio: float) -> int:
        """Return the value that comes nearest, or the one there is: coarse steps must not be taken to and fro."""
        wanted = exposure * min(max(ratio, 1.0 / _MOST_AT_ONCE), _MOST_AT_ONCE)
        below = self.exposure.clip(wanted)
        choices = (exposure, below, self.exposure.clip(below + self.exposure.step))
        return min(choices, key=lambda choice: abs(math.log(choice / (exposure * ratio))))

    def complaint(self, setting: Setting, bright: float) -> str:
        """Say what no setting can mend; empty where the light is right."""
        if setting == Setting(self.exposure.high, self.gain.high) and bright < _DARK * self.brightness:
            return (
                f"light is missing: white is at {bright:.0f} of {self.brightness:.0f} with the highest gain and the "
                f"longest exposure that the blur allows ({1e3 * to_seconds(setting.exposure):.1f} ms); add light, "
                "open the iris or allow more blur"
            )
        if setting == Setting(self.exposure.low, self.gain.low) and bright >= min(_WHITE, _BURNT_OUT * self.brightness):
            return "there is too much light: white burns out at the shortest exposure and lowest gain; close the iris"
        return ""


def white_level(image: GreyImage) -> float:
    """Return the level that nine tenths of a (height, width) picture do not exceed, from a sample of its pixels."""
    return float(np.percentile(image[::_SAMPLED, ::_SAMPLED], _BRIGHT_PERCENTILE))


class Exposure:
    """Holds the policy on one open device, whose automatic modes are off."""

    def __init__(self, node: Node, label: str, limit: BlurLimit, focal_px: float) -> None:
        self._node = node
        self._label = label
        self._exposure = _needed(node, label)
        self._gain = find_control(node, CID_GAIN)
        if self._gain is not None and self._gain.flags & (abi.CTRL_FLAG_READ_ONLY | abi.CTRL_FLAG_DISABLED):
            self._gain = None
        self._policy = Policy(self._exposures(limit, focal_px), self._gains(limit), limit.brightness)
        self._setting = self._policy.first()
        self._frames = 0
        self._note = ""
        set_control(node, f"{label}: exposure", self._exposure, self._setting.exposure)
        if self._gain is not None:
            set_control(node, f"{label}: gain", self._gain, self._setting.gain)
        self.exposure_s = to_seconds(self._setting.exposure)
        """What the device holds."""

    def follow(self, image: GreyImage) -> str:
        """Judge a picture and set the device for the next ones; return what an operator should know. Raises OSError."""
        self._frames += 1
        if self._frames >= SETTLE_FRAMES:
            self._frames = 0
            bright = white_level(image)
            setting = self._policy.after(self._setting, bright)
            complaint = self._policy.complaint(self._setting, bright)
            if not (complaint and self._note):  # the figures of a complaint are those it began with
                self._note = complaint
            if setting != self._setting:
                self._change(setting)
        return self._note

    def _exposures(self, limit: BlurLimit, focal_px: float) -> Range:
        control = self._exposure
        longest = to_units(limit.longest_s(focal_px))
        if longest < control.minimum:
            raise HardwareError(
                f"{self._label} exposes for {1e3 * to_seconds(control.minimum):.1f} ms at least, and a blur of "
                f"{limit.max_blur_px:g} px at {limit.speed_deg_s:g} deg/s allows "
                f"{1e3 * limit.longest_s(focal_px):.2f} ms; allow more blur"
            )
        allowed = Range(max(1, control.minimum), control.maximum, max(1, control.step))
        return replace(allowed, high=allowed.clip(longest))

    def _gains(self, limit: BlurLimit) -> Range:
        if self._gain is None:
            return Range(0, 0)
        allowed = Range(self._gain.minimum, self._gain.maximum, max(1, self._gain.step))
        return allowed if limit.max_gain is None else replace(allowed, high=allowed.clip(limit.max_gain))

    def _change(self, setting: Setting) -> None:
        """Set what differs; what the device makes of it is read back, and no reason to stop."""
        if setting.exposure != self._setting.exposure:
            self._node.set_value(self._exposure, setting.exposure)
            self.exposure_s = to_seconds(self._node.value(self._exposure))
        if self._gain is not None and setting.gain != self._setting.gain:
            self._node.set_value(self._gain, setting.gain)
        self._setting = setting


def _needed(node: Node, label: str) -> ControlInfo:
    control = find_control(node, CID_EXPOSURE_ABSOLUTE)
    if control is None or control.flags & (abi.CTRL_FLAG_READ_ONLY | abi.CTRL_FLAG_DISABLED):
        raise HardwareError(f"{label} has no exposure time that can be set; take `exposure` out")
    return control
