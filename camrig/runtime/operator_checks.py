"""Which devices an order may name and can reach now. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from camrig.errors import HardwareError, InputError
from camrig.messages import LinkStatus
from camrig.runtime.operator_status import View


def check_known(rig: str, kind: str, name: str, known: Iterable[str]) -> None:
    """Raise InputError, with those that there are, where a device is not one of them."""
    names = ", ".join(sorted(known))
    if name not in known:
        allowed = f"its {kind}s are {names}" if names else f"it has no {kind}s"
        raise InputError(f"rig '{rig}' has no {kind} {name!r}; {allowed}")


def check_here(view: View, head: str) -> None:
    """Raise HardwareError where another program has the head."""
    if head in view.lent:
        raise HardwareError(
            f"head {head} is lent to another program, as a calibration: wait until it ends, or end it by `camrig hold`"
        )


def unreached(view: View, devices: Iterable[str]) -> dict[str, str]:
    """Return the devices whose link is not up, and why."""
    reports = ((name, view.link(name)) for name in devices)
    return {
        name: f"link {report.status.value} ({report.reason})" if report.reason else f"link {report.status.value}"
        for name, report in reports
        if report.status is not LinkStatus.UP
    }
