"""VISCA pan-tilt heads on serial lines and UDP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from camrig.clock import Clock, RealClock
from camrig.interfaces import Driver, Head
from camrig.rig import HeadSpec
from camrig_drivers.visca.head import ViscaHead
from camrig_drivers.visca.line import Line
from camrig_drivers.visca.section import ViscaSection, check, line_of
from camrig_drivers.visca.transport import SerialTransport, Transport, UdpTransport
from camrig_drivers.visca.tuning import tuning

__all__ = ["driver"]


def _make(heads: Mapping[str, tuple[HeadSpec, ViscaSection]]) -> Mapping[str, Head]:
    """Build all heads; those of one serial line share it, with the longest gap and time-out any of them asks."""
    clock = RealClock()
    lines: dict[str, list[ViscaSection]] = {}
    for _, section in heads.values():
        lines.setdefault(line_of(section), []).append(section)
    built = {name: _line(sections, clock) for name, sections in lines.items()}
    return {name: ViscaHead(spec, section, built[line_of(section)], clock) for name, (spec, section) in heads.items()}


def _line(sections: Sequence[ViscaSection], clock: Clock) -> Line:
    return Line(
        _opener(sections[0], clock),
        clock,
        reply_timeout_s=max(section.reply_timeout_s for section in sections),
        gap_s=max(section.gap_s for section in sections),
    )


def _opener(section: ViscaSection, clock: Clock) -> Callable[[], Transport]:
    if section.udp is None:
        return partial(SerialTransport, section.port, section.baud, clock)
    host, port = section.udp
    return partial(UdpTransport, section.port, host, port, header=section.header, clock=clock)


driver: Driver[HeadSpec, Head] = Driver(section=ViscaSection, make=_make, check=check, tuning=tuning)
