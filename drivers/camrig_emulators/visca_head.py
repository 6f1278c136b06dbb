"""Emulated VISCA heads on a pseudo-terminal or on UDP, with the truth of where their optics point.

The parts: settings, wire (bytes), device (one head), bus (a serial line in time), datagrams (one head on UDP). They
are pure and may be stepped without thread or port; the classes here put them on a port that any driver can open.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence

from camrig.clock import Clock, RealClock
from camrig.errors import InputError
from camrig.interfaces import Plugin
from camrig_emulators.faults import Faults
from camrig_emulators.head_line import HeadLine, Stamped
from camrig_emulators.udp_port import UdpPort
from camrig_emulators.visca_bus import ViscaBus
from camrig_emulators.visca_device import ViscaHead
from camrig_emulators.visca_settings import ViscaEmulatorSection, ViscaHeadSettings
from camrig_emulators.visca_udp import ViscaDatagrams

__all__ = ["ViscaEmulatorSection", "ViscaHeadSettings", "ViscaLine", "ViscaUdpHead", "emulator"]

_REAL_CLOCK = RealClock()


class ViscaLine(HeadLine[ViscaHead]):
    """One line of VISCA heads."""

    def __init__(
        self, heads: Sequence[ViscaHeadSettings], *, clock: Clock = _REAL_CLOCK, seed: int = 0, name: str = "visca"
    ) -> None:
        """Build the line; ``name`` is the last part of the port's path. Raises InputError for heads that clash."""
        faults = Faults()
        super().__init__(ViscaBus(heads, faults, seed), faults, clock, name)

    def _describe(self, name: str, now_s: float) -> str:
        return _description(self._bus.heads[name], now_s)


class ViscaUdpHead:
    """One head on a UDP port of 127.0.0.1, with Sony's header or without it. Any thread."""

    def __init__(
        self, settings: ViscaHeadSettings, *, sony: bool = True, clock: Clock = _REAL_CLOCK, seed: int = 0
    ) -> None:
        """Build it; raises InputError for an address other than 1, the only one that UDP knows."""
        if settings.address != 1:
            raise InputError(f"a head on UDP has address 1, not {settings.address}")
        self.faults = Faults()
        self._clock = clock
        self._seed = seed
        self._lock = threading.Lock()
        self._datagrams = ViscaDatagrams(settings, self.faults, sony=sony, seed=seed)
        self._port: UdpPort | None = None

    @property
    def received(self) -> list[Stamped]:
        """Every message that arrived, without its header: (when, bytes)."""
        with self._lock:
            return list(self._datagrams.received)

    @property
    def sent(self) -> list[Stamped]:
        """Every answer, without its header: (when, bytes)."""
        with self._lock:
            return list(self._datagrams.sent)

    @property
    def port(self) -> str:
        """The url that a driver opens; raises RuntimeError before ``start``."""
        if self._port is None:
            raise RuntimeError("the emulated head has no port before it is started")
        return f"udpout://127.0.0.1:{self._port.port}"

    def start(self) -> str:
        if self._port is None:
            self._port = UdpPort("visca", self._datagrams, self._lock, self._clock, self.faults, self._seed)
        return self.port

    def stop(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def true_angles_rad(self, head_id: str, stamp_s: float) -> tuple[float, float]:
        """Return where its optics truly pointed at any stamp of the last minute; ``head_id`` is its own."""
        with self._lock:
            if head_id != self._datagrams.head.settings.id:
                raise KeyError(head_id)
            return _radians(self._datagrams.head.true_angles_deg(stamp_s))

    def describe(self) -> str:
        with self._lock:
            return _description(self._datagrams.head, self._clock.now_s())


def _radians(angles_deg: tuple[float, float]) -> tuple[float, float]:
    return math.radians(angles_deg[0]), math.radians(angles_deg[1])


def _description(head: ViscaHead, now_s: float) -> str:
    pan_deg, tilt_deg = head.true_angles_deg(now_s)
    moves = "still" if head.pan.motion.at_rest(now_s) and head.tilt.motion.at_rest(now_s) else "moving"
    return f"{head.settings.id} (address {head.address}): pan {pan_deg:+.2f} deg, tilt {tilt_deg:+.2f} deg, {moves}"


def _make(section: ViscaEmulatorSection) -> ViscaLine | ViscaUdpHead:
    common = section.model_dump(exclude={"id", "address", "heads", "seed", "transport"})
    names = [section.id] if section.heads == 1 else [f"{section.id}{k + 1}" for k in range(section.heads)]
    heads = [ViscaHeadSettings(id=name, address=section.address + k, **common) for k, name in enumerate(names)]
    if section.transport == "serial":
        return ViscaLine(heads, seed=section.seed)
    return ViscaUdpHead(heads[0], sony=section.transport == "udp", seed=section.seed)


emulator: Plugin[ViscaLine | ViscaUdpHead] = Plugin(section=ViscaEmulatorSection, make=_make)
