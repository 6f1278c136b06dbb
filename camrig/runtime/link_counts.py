"""What drivers count of their links."""

from __future__ import annotations

from collections.abc import Mapping

from camrig.interfaces import CountsItsLink


def counted(device: object) -> Mapping[str, float]:
    """Return a device's counts, none where its driver counts nothing; any thread."""
    return device.statistics() if isinstance(device, CountsItsLink) else {}
