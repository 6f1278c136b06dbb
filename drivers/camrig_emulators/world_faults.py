"""The faults of a device in the world's process, set from outside under the names of camrig_emulators.faults."""

from __future__ import annotations

from collections.abc import Callable

from camrig_emulators.world_wire import FaultName, SetFault


class WorldFaults:
    """What can go wrong with one emulated device; every call is done when it returns."""

    def __init__(self, device_id: str, send: Callable[[SetFault], None]) -> None:
        self._device_id = device_id
        self._send = send
        self._silent = self._freeze = False
        self._latency_s = 0.0

    @property
    def silent(self) -> bool:
        """No answers (head), no telemetry (drone), no frames (camera)."""
        return self._silent

    @silent.setter
    def silent(self, on: bool) -> None:
        self._set("silent", on)
        self._silent = on

    @property
    def freeze(self) -> bool:
        """The same position, or the same picture, again and again."""
        return self._freeze

    @freeze.setter
    def freeze(self, on: bool) -> None:
        self._set("freeze", on)
        self._freeze = on

    @property
    def latency_s(self) -> float:
        """By how much each answer, message or frame comes later."""
        return self._latency_s

    @latency_s.setter
    def latency_s(self, duration_s: float) -> None:
        self._set("latency_s", duration_s)
        self._latency_s = duration_s

    def unplug(self) -> None:
        """Take the device's port away; a head's line goes as a whole."""
        self._set("unplug")

    def replug(self) -> None:
        """Bring the port back."""
        self._set("replug")

    def drop_next(self, count: int) -> None:
        """Lose the next commands, or frames."""
        self._set("drop_next", count)

    def garble(self, probability: float) -> None:
        """Flip one bit in each byte on the wire with this probability, 0 to 1."""
        self._set("garble", probability)

    def truncate_reply(self, last: int, first: int = 0) -> None:
        """Lose the last and the first bytes of every answer; 0 = none."""
        self._set("truncate_reply", last, first)

    def happen(self, fault: str) -> None:
        """Let one thing happen to a drone, in the words of ``camrig_emulators.mavlink.troubles``: ``wind 2``."""
        self._set("happen", fault)

    def clear(self) -> None:
        """End every fault."""
        self._set("clear")
        self._silent = self._freeze = False
        self._latency_s = 0.0

    def _set(self, name: FaultName, *arguments: float | bool | str) -> None:
        self._send(SetFault(self._device_id, name, arguments))
