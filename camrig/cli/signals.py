"""Being told to stop by SIGINT, SIGTERM or SIGHUP: as an event, or as an interruption where it does no harm."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130
"""The exit code of what was told to stop before its end."""

_ASKING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@contextmanager
def asked_to_stop() -> Iterator[threading.Event]:
    """Yield what SIGINT, SIGTERM and SIGHUP set while inside, instead of interrupting."""
    asked = threading.Event()
    heard = [number for number in _ASKING if signal.getsignal(number) is not signal.SIG_IGN]  # as under nohup
    with on_signals(heard, asked.set):
        yield asked


@contextmanager
def on_signals(numbers: Iterable[signal.Signals], do: Callable[[], object]) -> Iterator[None]:
    """Have signals call ``do`` while inside."""

    def handle(number: int, frame: FrameType | None) -> None:
        del number, frame
        do()

    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def interrupting(now: Callable[[], float]) -> Iterator[Callable[[], float]]:
    """Yield the clock ``now``, which from the first signal on raises KeyboardInterrupt when it is read.

    For solvers, which read it often: an interruption inside a compiled kernel comes out of it as a SystemError.
    """
    with asked_to_stop() as asked:

        def read() -> float:
            if asked.is_set():
                raise KeyboardInterrupt
            return now()

        yield read
