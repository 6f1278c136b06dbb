"""Pan-tilt heads inside USB cameras, moved by V4L2 controls."""

from __future__ import annotations

from collections.abc import Mapping

from camrig.clock import RealClock
from camrig.interfaces import Driver, Head
from camrig.rig import HeadSpec
from camrig_drivers.uvc.head import UvcHead
from camrig_drivers.uvc.section import UvcSection, check
from camrig_drivers.v4l2.port import KernelPort

__all__ = ["UvcHead", "UvcSection", "driver"]


def _make(heads: Mapping[str, tuple[HeadSpec, UvcSection]]) -> Mapping[str, Head]:
    clock, port = RealClock(), KernelPort()
    return {name: UvcHead(spec, section, clock, port) for name, (spec, section) in heads.items()}


driver: Driver[HeadSpec, Head] = Driver(section=UvcSection, make=_make, check=check)
