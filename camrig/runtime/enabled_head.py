"""A head moved by a command of its own, without a daemon: open, enabled, and stopped however that ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from camrig.interfaces import Head
from camrig.runtime.guardian_link import GuardianLink


@contextmanager
def enabled(name: str, head: Head) -> Iterator[None]:
    """Have a head open and enabled while inside; a guardian process stops it should this one be killed.

    Raises LinkLost as the head does, and HardwareError where there is no guardian: then nothing is enabled.
    """
    with closing(GuardianLink()) as guardian:
        with closing(head):
            head.open()
            try:
                if (guard := head.guard()).stop_bytes:
                    guardian.hold(name, guard)
                head.enable()
                yield
            finally:
                head.stop()
        guardian.release(name)  # not where stop or close failed: then the guardian writes it once more
