"""Every error that camrig raises on purpose, in one tree.

    CamrigError                a sentence a user can act on; carries the exit code
    ├── InputError             exit 2: bad input or configuration; nothing was moved
    │   └── ConfigError        one or more faults of one file, all of them at once
    ├── HardwareError          exit 3: a device or link does not do what it must
    │   ├── LinkLost           normal in a rig: the worker reopens with back-off
    │   └── NotEnabledError    a motion was asked of a device nobody enabled
    └── PartialError           exit 4: something was done; what was not is named

Anything else that escapes is a bug: the daemon stops heads, holds drones and exits.
Drivers turn their library's exceptions into these with ``raise ... from error``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class CamrigError(Exception):
    """Base of the tree; its text is one sentence: what, where, what is allowed, what to do."""

    exit_code = 1


class InputError(CamrigError):
    """A file, an argument or a configuration is wrong."""

    exit_code = 2


@dataclass(frozen=True, slots=True, order=True)
class Fault:
    """One fault of a configuration file; ``line`` counts from 1, 0 where no line can be named."""

    file: str
    line: int
    key: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        return f"{place}: {self.key}: {self.message}" if self.key else f"{place}: {self.message}"


class ConfigError(InputError):
    """All the faults of one file."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(sorted(faults))
        super().__init__("\n".join(str(fault) for fault in self.faults))


class HardwareError(CamrigError):
    """A device refused, misbehaved or is missing."""

    exit_code = 3


class LinkLoss(StrEnum):
    """Why a link is lost, as it is published."""

    ABSENT = "absent"
    """Unplugged, or never plugged in."""
    BUSY = "busy"
    """Another program holds the device."""
    DENIED = "denied"
    """This user may not open it."""
    STALLED = "stalled"
    """It is there and delivers nothing that can be used."""
    CHANGED = "changed"
    """It came back as something else than what was configured."""
    FAILED = "failed"
    """Anything else: trouble on the wire or the bus."""


class LinkLost(HardwareError):  # noqa: N818 - a state of a link, named as it is published
    """The device's link is gone or silent; opening it again may bring it back."""

    def __init__(self, text: str, loss: LinkLoss = LinkLoss.FAILED) -> None:
        super().__init__(text)
        self.loss = loss


class NotEnabledError(HardwareError):
    """A motion was commanded before ``enable()`` (heads) or arming (drones)."""


class PartialError(CamrigError):
    """Some of the work was done; the text names what was not."""

    exit_code = 4


class EndOfInput(Exception):  # noqa: N818 - like StopIteration, a state and no error
    """A recording has been read to its end."""
