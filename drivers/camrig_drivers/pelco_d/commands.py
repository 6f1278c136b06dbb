"""What can be said to a Pelco-D head, as commands; what makers disagree on is the ``Dialect``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal, Protocol

from pydantic import BaseModel, ConfigDict

from camrig.errors import InputError
from camrig_drivers.pelco_d.codec import FULL_TURN_RAW, Axis, Command, Op

TOP_SPEED = 0x3F
TURBO = TOP_SPEED + 1
"""The pan speed that asks for the dialect's turbo byte."""
SPECIAL_PRESETS = frozenset({33, 34, *range(84, 106)})
"""Presets that many heads take as orders (flip, zero, wiper, reset, menu ...) when called, and some when set."""

STOP = Command(0x00, 0x00)
"""All motion ends. Never a direction with speed 0, which some heads take as the slowest creep (FLIR D300E)."""
ZOOM_TELE = Command(0x00, 0x20)
ZOOM_WIDE = Command(0x00, 0x40)
FOCUS_FAR = Command(0x00, 0x80)
FOCUS_NEAR = Command(0x01, 0x00)
IRIS_OPEN = Command(0x02, 0x00)
IRIS_CLOSE = Command(0x04, 0x00)
CAMERA_ON = Command(0x88, 0x00)
CAMERA_OFF = Command(0x08, 0x00)
AUTO_SCAN = Command(0x90, 0x00)
MANUAL_SCAN = Command(0x10, 0x00)


class Dialect(BaseModel):
    """Values on which Pelco's own texts or well-known senders disagree; the defaults are the majority's."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    turbo: Literal[0x40, 0xFF] | None = None
    """Speed byte of turbo; none, so that turbo is refused, unless the head's manual gives one."""
    auto_on: Literal[0, 2] = 0
    auto_off: Literal[0, 1, 2] = 1
    """Auto focus, auto iris and AGC."""
    blc_on: Literal[1, 2] = 2
    blc_off: Literal[0, 1, 2] = 1
    awb_off: Literal[0, 2] = 2
    magnification_msb: bool = True
    """Whether magnification is sent as 16 bits, or its low byte alone."""


PELCO = Dialect()

_WORD = range(0x10000)
_BYTE = range(0x100)
_ONE_TO_EIGHT = range(1, 9)
_VALUES: Mapping[Op, range] = MappingProxyType(
    dict.fromkeys((Op.SET_PRESET, Op.CLEAR_PRESET, Op.CALL_PRESET), range(1, 0x100))
    | dict.fromkeys((Op.SET_AUX, Op.CLEAR_AUX, Op.ZONE_START, Op.ZONE_END, Op.ALARM_ACK), _ONE_TO_EIGHT)
    | dict.fromkeys((Op.PATTERN_START, Op.PATTERN_STOP, Op.RUN_PATTERN), _BYTE)
    | dict.fromkeys((Op.ZOOM_SPEED, Op.FOCUS_SPEED), range(4))
    | dict.fromkeys((Op.AUTO_FOCUS, Op.AUTO_IRIS, Op.AGC, Op.BLC, Op.AWB), range(3))
    | dict.fromkeys((Op.SHUTTER, Op.LINE_LOCK, Op.WB_RB, Op.WB_MG, Op.GAIN, Op.IRIS_LEVEL, Op.IRIS_PEAK), _WORD)
    | dict.fromkeys((Op.SET_PAN, Op.SET_TILT), range(FULL_TURN_RAW))
    | dict.fromkeys((Op.SET_ZOOM, Op.SET_MAGNIFICATION, Op.WRITE_CHAR), _WORD)
)
"""What may follow an opcode, as one number over both data bytes; an opcode not listed carries 0."""


def extended(op: Op, value: int = 0, *, allow_special: bool = False) -> Command:
    """Return the extended command ``op``; raises InputError outside what it may carry.

    Special presets are refused unless ``allow_special``: calling one may turn, reset or reconfigure the head.
    """
    allowed = _VALUES.get(op, range(1))
    if value not in allowed:
        raise InputError(f"Pelco-D {op.name.lower()} carries {allowed.start}..{allowed.stop - 1}; got {value}")
    preset = op in (Op.SET_PRESET, Op.CLEAR_PRESET, Op.CALL_PRESET)
    if preset and value in SPECIAL_PRESETS and not allow_special:
        raise InputError(f"Pelco-D preset {value} is an order to many heads (33, 34, 84..105 are); use another number")
    return Command(0x00, op, value >> 8, value & 0xFF)


def drive(pan: int, tilt: int, dialect: Dialect = PELCO) -> Command:
    """Return a motion at constant speed bytes: ``pan`` -63..63, right positive; ``tilt`` -63..63, up positive.

    A pan of 64 either way is turbo. Raises InputError beyond that, and for turbo where the dialect has none. What
    speed a byte means is the head's own; the head goes on until the next command, some beyond 15 s.
    """
    if abs(pan) > TURBO or abs(tilt) > TOP_SPEED:
        raise InputError(f"Pelco-D speeds are -63..63, pan turbo -64 or 64; got pan {pan}, tilt {tilt}")
    pan_speed = dialect.turbo if abs(pan) == TURBO else abs(pan)
    if pan_speed is None:
        raise InputError("this head's dialect has no turbo; set 'turbo' to the byte of its manual (0x40 or 0xFF)")
    right_left = 0x02 if pan > 0 else 0x04 if pan < 0 else 0x00
    up_down = 0x08 if tilt > 0 else 0x10 if tilt < 0 else 0x00
    return Command(0x00, right_left | up_down, pan_speed, abs(tilt))


def set_position(axis: Axis, raw: int) -> Command:
    """Return the absolute move of one axis; angles, in hundredths of a degree, are wrapped into 0..35999."""
    return extended(axis.set_op, raw if axis is Axis.ZOOM else raw % FULL_TURN_RAW)


def query_position(axis: Axis) -> Command:
    """Return the query of one axis."""
    return extended(axis.query_op)


def switch(op: Op, *, on: bool, dialect: Dialect = PELCO) -> Command:
    """Return auto focus, auto iris, AGC, BLC or AWB switched on (automatic) or off."""
    if op is Op.BLC:
        return extended(op, dialect.blc_on if on else dialect.blc_off)
    if op is Op.AWB:
        return extended(op, 1 if on else dialect.awb_off)
    return extended(op, dialect.auto_on if on else dialect.auto_off)


def set_magnification(hundredths: int, dialect: Dialect = PELCO) -> Command:
    """Return magnification (500 is 5.00x) set; some heads take the same opcode as a focus position."""
    return extended(Op.SET_MAGNIFICATION, hundredths if dialect.magnification_msb else hundredths & 0xFF)


def write_char(column: int, character: str) -> Command:
    """Return one ASCII character written to the head's screen at column 0..39."""
    if column not in range(40) or len(character) != 1 or not character.isascii():
        raise InputError(f"Pelco-D writes one ASCII character at column 0..39; got {character!r} at {column}")
    return extended(Op.WRITE_CHAR, column << 8 | ord(character))


class LensSettings(Protocol):
    """What may be set of a head's own camera; None leaves it as it is."""

    @property
    def auto_focus(self) -> bool | None: ...

    @property
    def auto_iris(self) -> bool | None: ...

    @property
    def agc(self) -> bool | None: ...

    @property
    def blc(self) -> bool | None: ...

    @property
    def awb(self) -> bool | None: ...

    @property
    def magnification(self) -> float | None: ...


def lens_settings(wanted: LensSettings, dialect: Dialect) -> Sequence[Command]:
    """Return the commands that bring a head's own camera to what is wanted, magnification first."""
    switches = {
        Op.AUTO_FOCUS: wanted.auto_focus,
        Op.AUTO_IRIS: wanted.auto_iris,
        Op.AGC: wanted.agc,
        Op.BLC: wanted.blc,
        Op.AWB: wanted.awb,
    }
    zoom = [] if wanted.magnification is None else [set_magnification(round(100.0 * wanted.magnification), dialect)]
    return zoom + [switch(op, on=on, dialect=dialect) for op, on in switches.items() if on is not None]
