"""Emulated Pelco-D heads on a pseudo-terminal, with the truth of where their optics point.

The parts: settings, motion (one axis over time), wire (bytes), device (one head), bus (the line in time). They are
pure and may be stepped without thread or terminal; ``PelcoDLine`` puts them on a port that any driver can open.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence

from camrig.clock import Clock, RealClock
from camrig.interfaces import Plugin
from camrig_emulators.fault_script import FaultScript
from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_bus import PelcoDBus, Stamped
from camrig_emulators.pelco_d_settings import PelcoDEmulatorSection, PelcoDHeadSettings
from camrig_emulators.pty_line import PtyLine

__all__ = ["PelcoDEmulatorSection", "PelcoDHeadSettings", "PelcoDLine", "emulator"]

_REAL_CLOCK = RealClock()


class PelcoDLine:
    """One serial line with one or more heads. Everything here may be called from any thread.

    Until ``start`` there is neither a thread nor a port: with ``receive``, ``transmit`` and ``next_s`` a test steps
    the line by itself, in whatever time it likes.
    """

    def __init__(
        self,
        heads: Sequence[PelcoDHeadSettings],
        *,
        clock: Clock = _REAL_CLOCK,
        seed: int = 0,
        name: str = "pelco-d",
        script: str = "",
    ) -> None:
        """Build the line; ``name`` is the last part of the port's path, ``script`` what goes wrong and when, in the
        language of ``fault_script``, from now on. Raises InputError for heads that clash and for a wrong script.
        """
        self.faults = Faults()
        self._clock = clock
        self._lock = threading.RLock()
        happenings = FaultScript.parse(script, clock.now_s(), {head.id for head in heads})
        self._bus = PelcoDBus(heads, self.faults, seed, happenings)
        self.baud: int = self._bus.baud
        self._line = PtyLine(name, self, clock=clock, faults=self.faults)

    @property
    def head_faults(self) -> Mapping[str, Faults]:
        """The faults of single heads, by id; those of the whole line are ``faults``."""
        return {name: head.faults for name, head in self._bus.heads.items()}

    @property
    def received(self) -> list[Stamped]:
        """Every command with a correct sum that came over the wire, of any address: (end of its last byte, bytes)."""
        with self._lock:
            return list(self._bus.received)

    @property
    def sent(self) -> list[Stamped]:
        """Every answer that went out, as far as faults left it whole: (end of its last byte, bytes)."""
        with self._lock:
            return list(self._bus.sent)

    @property
    def port(self) -> str:
        """The path that a driver opens; raises RuntimeError before ``start``."""
        return self._line.path

    def start(self) -> str:
        self._line.start()
        return self._line.path

    def stop(self) -> None:
        self._line.stop()

    def true_angles_rad(self, head_id: str, stamp_s: float) -> tuple[float, float]:
        """Return where the optics of a head truly pointed: pan and tilt of docs/frames-and-units.md.

        Exact for any stamp of the last minute; a stamp to come is where the commands heard so far lead.
        """
        with self._lock:
            self._bus.advance(self._clock.now_s())
            pan_deg, tilt_deg = self._bus.heads[head_id].true_angles_deg(stamp_s)
        return math.radians(pan_deg), math.radians(tilt_deg)

    def describe(self) -> str:
        with self._lock:
            return "; ".join(self._describe(name) for name in self._bus.heads)

    # --- the far end of a serial line (pty_line.SerialDevice) -------------------------------------------------

    def receive(self, data: bytes, now_s: float, baud: int) -> None:
        with self._lock:
            self._bus.receive(data, now_s, baud)

    def transmit(self, now_s: float, baud: int) -> bytes:
        with self._lock:
            return self._bus.transmit(now_s, baud)

    def next_s(self) -> float | None:
        with self._lock:
            return self._bus.next_s()

    def cut(self) -> None:
        with self._lock:
            self._bus.cut()

    def _describe(self, name: str) -> str:
        now_s = self._clock.now_s()
        pan_rad, tilt_rad = self.true_angles_rad(name, now_s)
        head = self._bus.heads[name]
        moves = "still" if head.pan.motion.at_rest(now_s) and head.tilt.motion.at_rest(now_s) else "moving"
        heard = sum(frame[1] == head.settings.address for _, frame in self.received)
        answered = sum(frame[1] == head.settings.address for _, frame in self.sent if len(frame) > 1)
        return (
            f"{name} (address {head.settings.address}): pan {math.degrees(pan_rad):+.2f} deg, "
            f"tilt {math.degrees(tilt_rad):+.2f} deg, {moves}; {heard} heard, {answered} answered"
        )


def _make(section: PelcoDEmulatorSection) -> PelcoDLine:
    common = section.model_dump(exclude={"id", "address", "heads", "seed", "script"})
    names = [section.id] if section.heads == 1 else [f"{section.id}{k + 1}" for k in range(section.heads)]
    heads = [PelcoDHeadSettings(id=name, address=section.address + k, **common) for k, name in enumerate(names)]
    return PelcoDLine(heads, seed=section.seed, script=section.script)


emulator: Plugin[PelcoDLine] = Plugin(section=PelcoDEmulatorSection, make=_make)
