"""Jobs done by several processes, or by this one alone; whoever is slow keeps nobody waiting."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.pool import IMapIterator
from typing import Generic, TypeVar

import cv2

JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")

_PATIENCE_S = 0.2


def done(
    work: Callable[[JobT], ResultT], jobs: Sequence[JobT], processes: int, now: Callable[[], float]
) -> Iterator[tuple[JobT, ResultT]]:
    """Yield each job with its result as it is done. ``work`` is a function of a module, which processes can import.

    ``now`` is read now and then: it may raise an interruption. Processes that are still at work then are ended.
    """
    if processes <= 1 or len(jobs) <= 1:
        with _one_opencv_thread():
            for job in jobs:
                now()
                yield job, work(job)
        return
    context = multiprocessing.get_context("spawn")
    pool = context.Pool(min(processes, len(jobs)), _settle)
    try:
        results = pool.imap_unordered(_Numbered(work), enumerate(jobs))
        for _ in jobs:
            index, result = _awaited(results, now)
            yield jobs[index], result
    finally:
        pool.terminate()
        pool.join()


def _awaited(results: IMapIterator[ResultT], now: Callable[[], float]) -> ResultT:
    while True:
        now()
        with suppress(multiprocessing.TimeoutError):
            return results.next(_PATIENCE_S)


class _Numbered(Generic[JobT, ResultT]):
    """The work on a numbered job: results come in any order."""

    def __init__(self, work: Callable[[JobT], ResultT]) -> None:
        self._work = work

    def __call__(self, numbered: tuple[int, JobT]) -> tuple[int, ResultT]:
        index, job = numbered
        return index, self._work(job)


def _settle() -> None:
    """Leave interruptions to the parent, and the other cores to the other processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)


@contextmanager
def _one_opencv_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
