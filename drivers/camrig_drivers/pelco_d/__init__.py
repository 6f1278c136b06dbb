"""Pelco-D pan-tilt heads on serial lines."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from serial.tools import list_ports

from camrig.clock import Clock, RealClock
from camrig.interfaces import Driver, Found, Head
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d.bus import Bus, LineSettings
from camrig_drivers.pelco_d.head import PelcoDHead
from camrig_drivers.pelco_d.section import PelcoDSection, check, line_of
from camrig_drivers.pelco_d.tuning import tuning
from camrig_drivers.serial_port import Port, SerialPort

__all__ = ["buses_for", "driver"]

_BY_ID = Path("/dev/serial/by-id")
_DENIED = "it may not be opened by this user; add the user to the port's group (dialout on Debian) and log in again"


def _make(heads: Mapping[str, tuple[HeadSpec, PelcoDSection]]) -> Mapping[str, Head]:
    """Build all heads; those of one line share its bus, which takes the longest gap and time-out any of them asks."""
    clock = RealClock()
    buses = buses_for([section for _, section in heads.values()], clock)
    return {
        name: PelcoDHead(spec, section, buses[line_of(section.port)], clock) for name, (spec, section) in heads.items()
    }


def buses_for(
    sections: Sequence[PelcoDSection],
    clock: Clock,
    open_port: Callable[[str, int], SerialPort] = Port,
    make_condition: Callable[[], threading.Condition] = threading.Condition,
) -> Mapping[str, Bus]:
    """Return the bus of each line, by ``line_of`` of its port."""
    lines: dict[str, list[PelcoDSection]] = {}
    for section in sections:
        lines.setdefault(line_of(section.port), []).append(section)
    return {line: Bus(_settings(sharing), clock, open_port, make_condition) for line, sharing in lines.items()}


def _settings(sections: Sequence[PelcoDSection]) -> LineSettings:
    first = sections[0]
    return LineSettings(
        port=first.port,
        baud=first.baud,
        gap_s=max(section.gap_s for section in sections),
        reply_timeout_s=max(section.reply_timeout_s for section in sections),
        echo=first.echo,
        resync_tail=first.resync_tail,
    )


def _discover() -> Sequence[Found]:
    """List serial ports, each by the name that survives a replug where it has one; opens none."""
    by_device = {str(link.resolve()): str(link) for link in sorted(_BY_ID.glob("*"))}
    found = []
    for port in sorted(list_ports.comports()):
        name = by_device.get(port.device, port.device)
        trouble = "" if os.access(port.device, os.R_OK | os.W_OK) else _DENIED
        facts = {"node": port.device, "serial": port.serial_number or "", "hardware": port.hwid}
        section = {"port": name, "baud": PelcoDSection.model_fields["baud"].default, "address": 1}
        found.append(Found(name, _title(port.description), section, facts=facts, trouble=trouble))
    return found


def _title(description: str) -> str:
    return "serial port" if description == "n/a" else description


driver: Driver[HeadSpec, Head] = Driver(
    section=PelcoDSection, make=_make, check=check, discover=_discover, tuning=tuning
)
