"""What drivers count of their links."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from camrig.interfaces import CountsItsLink
from camrig.runtime.worker import Worker


def counted(device: object) -> Mapping[str, float]:
    """Return a device's counts, none where its driver counts nothing; any thread."""
    return device.statistics() if isinstance(device, CountsItsLink) else {}


class _Counting(Protocol):
    def statistics(self) -> Mapping[str, float]: ...


def counted_of_all(
    groups: Iterable[Mapping[str, _Counting]], workers: Iterable[Worker]
) -> dict[str, Mapping[str, float]]:
    """Return what was counted of every link, by device, and how often its worker lost it."""
    lost = {worker.job.name: {"losses": worker.losses} for worker in workers}
    return {name: {**lost.get(name, {}), **job.statistics()} for jobs in groups for name, job in jobs.items()}
