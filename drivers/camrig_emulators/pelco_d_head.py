"""Emulated Pelco-D heads on a pseudo-terminal, with the truth of where their optics point.

The parts: settings, motion (one axis over time), wire (bytes), device (one head), bus (the line in time). They are
pure and may be stepped without thread or terminal; ``PelcoDLine`` puts them on a port that any driver can open.
"""

from __future__ import annotations

from collections.abc import Sequence

from camrig.clock import Clock, RealClock
from camrig.interfaces import Plugin
from camrig_emulators.fault_script import FaultScript
from camrig_emulators.faults import Faults
from camrig_emulators.head_line import HeadLine
from camrig_emulators.pelco_d_bus import PelcoDBus
from camrig_emulators.pelco_d_device import PelcoDHead
from camrig_emulators.pelco_d_settings import PelcoDEmulatorSection, PelcoDHeadSettings

__all__ = ["PelcoDEmulatorSection", "PelcoDHeadSettings", "PelcoDLine", "emulator"]

_REAL_CLOCK = RealClock()


class PelcoDLine(HeadLine[PelcoDHead]):
    """One line of Pelco-D heads."""

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
        faults = Faults()
        happenings = FaultScript.parse(script, clock.now_s(), {head.id for head in heads})
        super().__init__(PelcoDBus(heads, faults, seed, happenings), faults, clock, name)

    def _describe(self, name: str, now_s: float) -> str:
        head = self._bus.heads[name]
        pan_deg, tilt_deg = head.true_angles_deg(now_s)
        moves = "still" if head.pan.motion.at_rest(now_s) and head.tilt.motion.at_rest(now_s) else "moving"
        heard = sum(frame[1] == head.settings.address for _, frame in self.received)
        answered = sum(frame[1] == head.settings.address for _, frame in self.sent if len(frame) > 1)
        return (
            f"{name} (address {head.settings.address}): pan {pan_deg:+.2f} deg, tilt {tilt_deg:+.2f} deg, {moves}; "
            f"{heard} heard, {answered} answered"
        )


def _make(section: PelcoDEmulatorSection) -> PelcoDLine:
    common = section.model_dump(exclude={"id", "address", "heads", "seed", "script"})
    names = [section.id] if section.heads == 1 else [f"{section.id}{k + 1}" for k in range(section.heads)]
    heads = [PelcoDHeadSettings(id=name, address=section.address + k, **common) for k, name in enumerate(names)]
    return PelcoDLine(heads, seed=section.seed, script=section.script)


emulator: Plugin[PelcoDLine] = Plugin(section=PelcoDEmulatorSection, make=_make)
