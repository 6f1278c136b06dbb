"""A stop for everything that moves, whatever becomes of one of them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from camrig.runtime.drone_job import DroneJob
from camrig.runtime.head_job import HeadJob
from camrig.runtime.worker import log_failure

log = logging.getLogger(__name__)


def halt(jobs: Sequence[HeadJob | DroneJob]) -> Mapping[str, str]:
    """Stop heads and hold drones; return what failed, by device. Any thread."""
    failed: dict[str, str] = {}
    for job in jobs:
        try:
            job.stop()
        except Exception as error:  # whatever it is, one head's trouble must not keep the next from its stop
            log_failure(log, f"{job.name}: stop failed", error)
            failed[job.name] = str(error)
    return failed
