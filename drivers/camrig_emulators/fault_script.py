"""Faults by the clock, as a text that a person writes: one statement a line, or several with ';' between.

    at 2.5 unplug                    once, at 2.5 s
    at 4 replug
    from 5 to 7 silent               on at 5 s, off at 7 s
    from 5 to 7 on pt2 garble 0.02   of one head alone; a number follows what needs one
    at 9 on pt1 reset                a brown-out: deaf, then driving home
    at 10 drop 3                     the next three commands are lost
    at 11 clear                      every fault ends

``#`` begins a comment. Seconds count from when the emulator was made.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from camrig.errors import InputError
from camrig_emulators.faults import Faults

Setter = Callable[[Faults, float], None]

_STATEMENT = re.compile(
    r"(?:at\s+(?P<at>[\d.]+)|from\s+(?P<first>[\d.]+)\s+to\s+(?P<last>[\d.]+))"
    r"(?:\s+on\s+(?P<head>\S+))?\s+(?P<name>[a-z_]+)(?:\s+(?P<value>[\d.]+))?"
)


def _flag(name: str) -> Setter:
    return lambda faults, value: setattr(faults, name, value > 0.0)


def _number(name: str) -> Setter:
    return lambda faults, value: setattr(faults, name, value)


_SWITCHES: Mapping[str, Setter] = MappingProxyType(
    {name: _flag(name) for name in ("silent", "freeze", "echo", "stuck", "swapped", "splits")}
)
_AMOUNTS: Mapping[str, Setter] = MappingProxyType(
    {
        "latency": _number("latency_s"),
        "echo_delay": _number("echo_delay_s"),
        "echo_bytes": lambda faults, value: setattr(faults, "echo_bytes", round(value) or None),
        "garble": Faults.garble,
        "lose": Faults.lose,
        "insert": Faults.insert,
        "bursts": Faults.bursts,
        "lost_first": lambda faults, value: faults.truncate_reply(0, first=round(value)),
        "lost_last": lambda faults, value: faults.truncate_reply(round(value)),
    }
)
_EVENTS: Mapping[str, Setter] = MappingProxyType(
    {
        "unplug": lambda faults, _: faults.unplug(),
        "replug": lambda faults, _: faults.replug(),
        "clear": lambda faults, _: faults.clear(),
        "drop": lambda faults, value: faults.drop_next(round(value)),
        "reset": lambda faults, value: None,  # of the head, not of its faults: the line does these two
        "alarm": lambda faults, value: None,
    }
)
_NEED_A_NUMBER = {*_AMOUNTS, "drop", "alarm"}
_LINE_ONLY = {
    "unplug",
    "replug",
    "echo",
    "echo_bytes",
    "echo_delay",
    "stuck",
    "swapped",
    "splits",
    "lose",
    "insert",
    "bursts",
    "garble",
}
_PROBABILITIES = {"garble", "lose", "insert", "bursts"}


@dataclass(frozen=True, slots=True)
class Happening:
    """One thing that happens; ``head`` is None for the whole line."""

    stamp_s: float
    name: str
    value: float
    head: str | None

    def set(self, faults: Faults) -> None:
        """Make it so."""
        {**_SWITCHES, **_AMOUNTS, **_EVENTS}[self.name](faults, self.value)


class FaultScript:
    """What is to happen, in order."""

    def __init__(self, happenings: Iterable[Happening]) -> None:
        self._ahead = deque(sorted(happenings, key=lambda happening: happening.stamp_s))

    @classmethod
    def parse(cls, text: str, start_s: float, heads: Collection[str]) -> FaultScript:
        """Read a script whose second 0 is ``start_s``; raises InputError that names the statement."""
        found: list[Happening] = []
        for line in text.splitlines():
            for statement in line.partition("#")[0].split(";"):
                if statement.strip():
                    found += _parse(statement.strip(), start_s, heads)
        return cls(found)

    def next_s(self) -> float | None:
        """Return when the next thing happens; None for never."""
        return self._ahead[0].stamp_s if self._ahead else None

    def due(self, now_s: float) -> list[Happening]:
        """Take what has happened by now."""
        due = []
        while self._ahead and self._ahead[0].stamp_s <= now_s:
            due.append(self._ahead.popleft())
        return due


def _parse(statement: str, start_s: float, heads: Collection[str]) -> list[Happening]:
    match = _STATEMENT.fullmatch(statement)
    if match is None:
        raise _wrong(statement, "write 'at SECONDS FAULT' or 'from SECONDS to SECONDS [on HEAD] FAULT [NUMBER]'")
    name, head, spans = match["name"], match["head"], match["at"] is None
    allowed = {**_SWITCHES, **_AMOUNTS} if spans else {**_EVENTS, **_SWITCHES, **_AMOUNTS}
    if name not in allowed:
        raise _wrong(statement, f"'{name}' is none of {', '.join(sorted(allowed))}")
    if (match["value"] is None) == (name in _NEED_A_NUMBER):
        raise _wrong(statement, f"{name} {'needs a number' if match['value'] is None else 'takes no number'}")
    if head is not None and head not in heads:
        raise _wrong(statement, f"there is no head '{head}', but {', '.join(sorted(heads))}")
    if head is not None and name in _LINE_ONLY:
        raise _wrong(statement, f"{name} happens to the line, not to one head: leave out 'on {head}'")
    try:
        value = float(match["value"] or 1.0)
        stamps = [float(match[key]) for key in (("first", "last") if spans else ("at",))]
    except ValueError:
        raise _wrong(statement, "a number is written like 2 or 2.5") from None
    if name in _PROBABILITIES and value > 1.0:
        raise _wrong(statement, f"{name} takes a probability, 0 to 1")
    if spans and stamps[1] <= stamps[0]:
        raise _wrong(statement, "it ends before it begins")
    begin = Happening(start_s + stamps[0], name, value, head)
    return [begin, Happening(start_s + stamps[1], name, 0.0, head)] if spans else [begin]


def _wrong(statement: str, why: str) -> InputError:
    return InputError(f"fault script: '{statement}': {why}")
