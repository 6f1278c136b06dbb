"""An emulated Pelco-D head on a bench: its settings, what it reads back and where it truly looks."""

from __future__ import annotations

import math

from camrig_emulators.pelco_d_bench import Bench
from camrig_emulators.pelco_d_head import PelcoDHeadSettings

STOP, LEFT, RIGHT, UP, DOWN = 0x00, 0x04, 0x02, 0x08, 0x10


def head(name: str = "head", **changed: object) -> PelcoDHeadSettings:
    """Return a head that differs from the usual one in what is given."""
    return PelcoDHeadSettings.model_validate({"id": name, **changed})


def read_raw(bench: Bench, opcode: int, address: int = 1) -> int:
    """Return the value of the extended answer to a query."""
    reply = bench.ask(address, opcode)
    assert len(reply) == 7
    return reply[4] << 8 | reply[5]


def truth_deg(bench: Bench, name: str = "head") -> tuple[float, float]:
    """Return pan and tilt as they are now, whatever the head reports."""
    pan_rad, tilt_rad = bench.line.true_angles_rad(name, bench.now_s)
    return math.degrees(pan_rad), math.degrees(tilt_rad)
