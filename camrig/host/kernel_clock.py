"""What the kernel knows of its own clock: adjtimex(2), asked without changing anything."""

from __future__ import annotations

import ctypes
import os
from ctypes import c_int, c_long
from dataclasses import dataclass

_TIME_ERROR = 5
_STA_UNSYNC = 0x0040


class _Timex(ctypes.Structure):
    """struct timex of linux/timex.h."""

    _fields_ = (
        ("modes", c_int),
        ("offset", c_long),
        ("freq", c_long),
        ("maxerror", c_long),
        ("esterror", c_long),
        ("status", c_int),
        ("constant", c_long),
        ("precision", c_long),
        ("tolerance", c_long),
        ("time", c_long * 2),
        ("tick", c_long),
        ("ppsfreq", c_long),
        ("jitter", c_long),
        ("shift", c_int),
        ("stabil", c_long),
        ("counts", c_long * 4),
        ("tai", c_int),
        ("reserved", c_int * 11),
    )


@dataclass(frozen=True, slots=True)
class KernelClock:
    """Whether something disciplines the clock, and how far off the kernel takes it to be at most."""

    synchronised: bool
    max_error_s: float


def ask_kernel_clock() -> KernelClock:
    """Ask; raises OSError where the kernel will not tell."""
    answer = _Timex(modes=0)
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(answer))
    if state < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return KernelClock(state != _TIME_ERROR and not answer.status & _STA_UNSYNC, 1e-6 * answer.maxerror)
