"""What speed a speed byte means: makers differ, and it is rarely in proportion."""

from __future__ import annotations

import math
from typing import Literal

Curve = Literal["linear", "geometric", "bell"]

FULL_SPEED = 0x3F
_GEOMETRIC_SPAN = 150.0
"""The fastest byte is so many times as fast as the slowest (EVI-D100: 2 to 300 deg/s)."""


def share_of_full_speed(byte: int, curve: Curve, dead_bytes: int) -> float:
    """Return the part of full speed that a byte of 1..63 stands for; the first ``dead_bytes`` turn nothing.

    bell: the lower two thirds of the range give little motion (the default of Pelco Sarix).
    """
    byte = min(byte, FULL_SPEED)
    if byte <= dead_bytes:
        return 0.0
    part = (byte - dead_bytes) / (FULL_SPEED - dead_bytes)
    match curve:
        case "linear":
            return part
        case "geometric":
            return math.pow(_GEOMETRIC_SPAN, part - 1.0)
        case "bell":
            return part**4
