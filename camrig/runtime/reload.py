"""A rig that is run until it is to end, over reloads of its file (docs/decisions/0010)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from camrig.clock import Clock, RealClock
from camrig.config.rig_file import RigConfig, load_rig
from camrig.config.settings import settings_of
from camrig.errors import CamrigError, HardwareError, InputError
from camrig.interfaces import Sink
from camrig.runtime import last_run
from camrig.runtime.daemon import Daemon
from camrig.runtime.emulated import emulated_world

log = logging.getLogger(__name__)

SETTLED_S = 10.0
"""A reloaded rig that fails sooner has not started."""

Serving = Callable[[Daemon], AbstractContextManager[None]]


@dataclass
class Run:
    """Runs the daemon of one configuration after the other.

    ``serving`` surrounds a daemon while it is supervised (the operator's socket). ``request_stop`` and
    ``request_reload`` may be called by signal handlers.
    """

    file: Path
    config: RigConfig
    sinks: Sequence[Sink]
    serving: Serving
    clock: Clock = field(default_factory=RealClock)
    kept_in: Path | None = None
    """The folder where what is run is noted, for whoever has to stop its heads (``runtime.last_run``)."""
    _daemon: Daemon | None = None
    _ending: bool = False

    def until(self, until_s: float) -> None:
        """Run until a stop is requested, every recording has ended, or ``until_s``; raises what ended a daemon."""
        self._run(until_s)
        if self.kept_in is not None:
            last_run.forget(self.file, self.kept_in)

    def _run(self, until_s: float) -> None:
        before: RigConfig | None = None
        current: RigConfig | None = self.config
        held: frozenset[str] = frozenset()
        remark = ""
        while current is not None:
            try:
                daemon = self._one(current, before, held, remark, until_s)
            except _NotStartedError as error:
                if before is None or self._ending:
                    raise error.reason from error
                log.error("the new configuration does not start, back to the one before: %s", error.reason)  # noqa: TRY400
                current, before, remark = before, None, f"reload failed: {error.reason}"
            else:
                before, current, held, remark = current, daemon.successor, daemon.held, ""
                if current is not None and held:  # a head of a new name may be one that is held, or stand beside it
                    held |= current.rig.heads.keys() - before.rig.heads.keys()
                if self._ending:
                    return
                daemon.notifier.alive()  # nobody supervises between two daemons

    def request_stop(self) -> None:
        """Ask for the end."""
        self._ending = True
        if self._daemon is not None:
            self._daemon.request_stop()

    def request_reload(self) -> None:
        """Ask for the file to be read again."""
        if self._daemon is not None:
            self._daemon.request_reload()

    def _one(
        self, config: RigConfig, fallback: RigConfig | None, held: frozenset[str], remark: str, until_s: float
    ) -> Daemon:
        if self.kept_in is not None:
            last_run.keep(config, self.kept_in)
        with emulated_world(config) as (rig_config, _):
            daemon = Daemon(rig_config, settings_of(rig_config), self.sinks, self.clock, held=held, remark=remark)
            before, self._daemon = self._daemon, daemon
            if self._ending:  # asked between two daemons
                daemon.request_stop()
            if before is not None and before.reload_requested:
                daemon.request_reload()
            try:
                daemon.start()
            except CamrigError as error:
                raise _NotStartedError(error) from error
            began_s = self.clock.now_s()
            try:
                with self.serving(daemon):
                    daemon.supervise(until_s, lambda: self._next(config, daemon))
            except CamrigError as error:  # only opening shows that a device is not what the file says
                if fallback is None or self.clock.now_s() > began_s + SETTLED_S:
                    raise
                daemon.successor = fallback  # it hands over: systemd must not be told of an end
                raise _NotStartedError(error) from error
            finally:
                daemon.stop()
        return daemon

    def _next(self, current: RigConfig, daemon: Daemon) -> RigConfig:
        """Return what the file says now; raises the CamrigError that keeps the running configuration."""
        found = load_rig(self.file)
        if found.rig.name != current.rig.name:
            raise InputError(
                f"{self.file} is now of rig '{found.rig.name}', not of '{current.rig.name}': restart for another rig"
            )
        if daemon.airborne:
            raise HardwareError(f"{', '.join(daemon.airborne)} in the air: land before a reload")
        if daemon.loans.lent:  # the next daemon would open what another program moves
            lent = ", ".join(sorted(daemon.loans.lent))
            raise HardwareError(f"{lent} lent to another program: reload when it has given them back")
        return found


class _NotStartedError(Exception):
    """A daemon did not start; says why."""

    def __init__(self, reason: CamrigError) -> None:
        super().__init__(str(reason))
        self.reason = reason
