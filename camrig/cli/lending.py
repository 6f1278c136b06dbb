"""A head and its camera lent by the daemon that runs them, for as long as a command needs them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from camrig.cli.console import people
from camrig.cli.operating import part
from camrig.clock import Clock
from camrig.errors import CamrigError, HardwareError, InputError
from camrig.runtime.operator_client import ask, find_socket

_FOR_S, _RENEW_S = 45.0, 1.0
"""A daemon takes back what is lent should this program die; and so often it is asked whether somebody held the rig."""
_LET_GO_S = 10.0
_LOOK_S = 0.2


@dataclass
class _Lease:
    path: Path
    head: str
    clock: Clock
    refused: threading.Event = field(default_factory=threading.Event)
    _ended: threading.Event = field(default_factory=threading.Event)

    def take(self) -> None:
        """Wait until both devices are free. Raises HardwareError where the daemon does not let go of them."""
        told = self._ask(_FOR_S)["devices"]
        devices = [str(name) for name in told] if isinstance(told, list) else []
        until_s = self.clock.now_s() + _LET_GO_S
        while self.clock.now_s() < until_s:
            status = ask(self.path, {"command": "status"})
            both = {**part(status, "heads"), **part(status, "cameras")}
            if all(part(both, name).get("link") == "closed" for name in devices):
                return
            self.clock.sleep_s(_LOOK_S)
        raise HardwareError(f"the daemon at {self.path} does not let go of {' and '.join(devices)}; look at its log")

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Renew it all the while in a thread of its own: a daemon that stalls must not keep a head from its stop."""
        thread = threading.Thread(target=self._keep, name=f"lease of {self.head}", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._ended.set()
            thread.join()

    def give_back(self) -> None:
        self._ask(0.0)

    def _keep(self) -> None:
        while not (self._ended.wait(_RENEW_S) or self.refused.is_set()):
            try:
                self._ask(_FOR_S, renew=True)
            except InputError:  # held, or expired while the daemon stalled: it is the daemon's again
                self.refused.set()
            except CamrigError:  # a daemon that has gone takes nothing back
                continue

    def _ask(self, for_s: float, *, renew: bool = False) -> dict[str, object]:
        return ask(self.path, {"command": "lend", "head": self.head, "for_s": for_s, "renew": renew})


@contextmanager
def lent(rig: str, head: str, clock: Clock) -> Iterator[threading.Event]:
    """Have a running daemon of ``rig`` lend a head and its camera while inside; its other cameras work on.

    Yields what is set once the daemon has taken them back, as `camrig hold` does: the head is to be stopped at once.
    Without such a daemon that never happens.
    """
    try:
        path = find_socket(rig)
    except HardwareError:  # nobody has them
        yield threading.Event()
        return
    lease = _Lease(path, head, clock)
    lease.take()
    people.print(f"the daemon of {rig} lends {head} and its camera; the rest works on", highlight=False, markup=False)
    try:
        with lease.kept():
            yield lease.refused
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
