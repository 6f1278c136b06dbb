"""A head and its camera lent by the daemon that runs them, for as long as a command needs them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from camrig.cli.console import people
from camrig.cli.operating import part
from camrig.clock import Clock
from camrig.errors import CamrigError, HardwareError
from camrig.runtime.operator_client import ask, find_socket

_FOR_S, _RENEW_S = 45.0, 15.0
"""A daemon takes back what is lent should this program die."""
_LET_GO_S = 10.0
_LOOK_S = 0.2


@dataclass
class _Lease:
    path: Path
    head: str
    clock: Clock
    _renewed_s: float = -1e9

    def keep(self) -> None:
        """Renew it where that is due."""
        if self.clock.now_s() > self._renewed_s + _RENEW_S:
            with suppress(HardwareError):  # a daemon that has gone takes nothing back
                self._ask(_FOR_S)

    def take(self) -> None:
        """Wait until both devices are free. Raises HardwareError where the daemon does not let go of them."""
        devices = self._ask(_FOR_S)
        until_s = self.clock.now_s() + _LET_GO_S
        while self.clock.now_s() < until_s:
            told = ask(self.path, {"command": "status"})
            both = {**part(told, "heads"), **part(told, "cameras")}
            if all(part(both, name).get("link") == "closed" for name in devices):
                return
            self.clock.sleep_s(_LOOK_S)
        raise HardwareError(f"the daemon at {self.path} does not let go of {' and '.join(devices)}; look at its log")

    def give_back(self) -> None:
        self._ask(0.0)

    def _ask(self, for_s: float) -> list[str]:
        self._renewed_s = self.clock.now_s()
        devices = ask(self.path, {"command": "lend", "head": self.head, "for_s": for_s})["devices"]
        return [str(name) for name in devices] if isinstance(devices, list) else []


@contextmanager
def lent(rig: str, head: str, clock: Clock) -> Iterator[Callable[[], None]]:
    """Have a running daemon of ``rig`` lend a head and its camera while inside; its other cameras work on.

    Yields what is to be called every few seconds, which keeps the loan. Without such a daemon that does nothing.
    """
    try:
        path = find_socket(rig)
    except HardwareError:  # nobody has them
        yield lambda: None
        return
    lease = _Lease(path, head, clock)
    lease.take()
    people.print(f"the daemon of {rig} lends {head} and its camera; the rest works on", highlight=False, markup=False)
    try:
        yield lease.keep
    finally:
        try:
            lease.give_back()
        except CamrigError as error:
            people.print(f"{head} is not given back: {error}", style="yellow", highlight=False, markup=False)
        else:
            people.print(
                f"{head} is given back, held: reload the daemon if its file changed, then `camrig resume {head}`",
                highlight=False,
                markup=False,
            )
