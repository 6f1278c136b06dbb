"""From the kernel's stamp of a buffer to mid-exposure of the picture's centre row.

Let the first row begin its exposure at t0, every row be exposed for ``exposure_s`` and the last row begin
``readout_s`` after the first. The centre row is then exposed around

    t0 + readout_s / 2 + exposure_s / 2.

A stamp of the *start of exposure* is t0. A stamp of the *end of frame* is taken when the last row has been read, at
t0 + readout_s + exposure_s. What the transfer to this computer adds to the latter is not known here, nor how long a
global shutter (``readout_s`` 0) takes to read its pixels out.
"""

from __future__ import annotations

from typing import NamedTuple

from camrig_drivers.v4l2 import abi

_RECENT_S = 10.0
"""A stamp of a clock that is not named is ours if it is of so short ago: wall clocks are decades away."""


class Stamp(NamedTuple):
    """``known`` only where the clock, the kind of stamp and the exposure time all are."""

    stamp_s: float
    known: bool


def mid_exposure(buffer_s: float, flags: int, now_s: float, *, exposure_s: float | None, readout_s: float) -> Stamp:
    """Return the stamp of a frame whose buffer was dequeued at ``now_s``.

    A buffer's stamp of another clock, or ahead of ours, is no time of ours: the end of the frame is then taken to be
    now. Of a clock that the device does not name (v4l2loopback's) it is used where it can be ours. An unknown exposure
    time counts as zero. In all these cases the stamp is not known.
    """
    half_s = 0.5 * (readout_s + (exposure_s or 0.0))
    ours = flags & abi.BUF_FLAG_TIMESTAMP_MASK == abi.BUF_FLAG_TIMESTAMP_MONOTONIC
    if buffer_s > now_s or not (ours or now_s - buffer_s < _RECENT_S):
        return Stamp(now_s - half_s, known=False)
    known = ours and exposure_s is not None
    source = flags & abi.BUF_FLAG_TSTAMP_SRC_MASK
    if source == abi.BUF_FLAG_TSTAMP_SRC_SOE:
        return Stamp(buffer_s + half_s, known)
    if source == abi.BUF_FLAG_TSTAMP_SRC_EOF:
        return Stamp(buffer_s - half_s, known)
    return Stamp(buffer_s, known=False)
