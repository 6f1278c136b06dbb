"""Heads, each with its camera, that other programs have for a while: one order for both, and one way back."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from camrig.clock import Clock
from camrig.errors import InputError
from camrig.rig import Rig
from camrig.runtime.head_job import HeadJob
from camrig.runtime.worker import Worker


@dataclass(frozen=True)
class Loans:
    """What the workers of a rig have lent. Any thread."""

    rig: Rig
    clock: Clock
    workers: Sequence[Worker]

    def lend(self, job: HeadJob, for_s: float) -> Collection[str]:
        """Let go of a head and its camera for so long, 0: take them back; return both. Who calls stops the head."""
        if for_s > 0.0:
            job.lend()
        return self._until(job.name, self.clock.now_s() + for_s)

    def renew(self, head: str, for_s: float) -> Collection[str]:
        """Lend them for longer; raises InputError where they are not lent any more."""
        if head not in self.lent:
            raise InputError(
                f"head {head} is not lent any more: somebody held the rig, it was not asked for in time, or the "
                "daemon was started anew; stop it and let go of it"
            )
        return self._until(head, self.clock.now_s() + for_s)

    def end(self) -> None:
        """Take everything back: every head is stopped when it is opened, and who has it is refused more time."""
        for worker in self.workers:
            if worker.lent:
                worker.lend(self.clock.now_s())

    @property
    def lent(self) -> frozenset[str]:
        """The devices that other programs have now."""
        return frozenset(worker.job.name for worker in self.workers if worker.lent)

    def _until(self, head: str, until_s: float) -> Collection[str]:
        devices = {head, *(camera.id for camera in [self.rig.camera_on(head)] if camera is not None)}
        for worker in self.workers:
            if worker.job.name in devices:
                worker.lend(until_s)
        return devices
