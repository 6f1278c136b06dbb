"""Faults by the clock, as a text that a person writes: one statement a line, or several with ';' between.

    at 2.5 unplug                    once, at 2.5 s
    at 4 replug
    from 5 to 7 silent               on at 5 s, off at 7 s
    from 5 to 7 on pt2 garble 0.02   of one head alone; a number follows what needs one
    at 9 on pt1 reset                a brown-out: deaf, then driving home
    at 10 drop 3                     the next three commands are lost
    at 11 clear                      every fault ends

``#`` begins a comment. Seconds count from when the emulator was made. Which faults there are depends on the device:
``HEADS`` has those of Pelco-D heads, ``camrig_emulators.mavlink.troubles`` those of drones.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from camrig.errors import InputError
from camrig_emulators.faults import Faults

Setter = Callable[[Faults, float], None]

_STATEMENT = re.compile(
    r"(?:at\s+(?P<at>[\d.]+)|from\s+(?P<first>[\d.]+)\s+to\s+(?P<last>[\d.]+))"
    r"(?:\s+on\s+(?P<head>\S+))?\s+(?P<name>[a-z_]+)(?:\s+(?P<value>-?[\d.]+|\w+))?"
)


def _flag(name: str) -> Setter:
    return lambda faults, value: setattr(faults, name, value > 0.0)


def _number(name: str) -> Setter:
    return lambda faults, value: setattr(faults, name, value)


def device_does(faults: Faults, value: float) -> None:
    """Set nothing on the link: what happens concerns the device, which knows it by its name."""


SWITCHES: Mapping[str, Setter] = MappingProxyType(
    {name: _flag(name) for name in ("silent", "freeze", "echo", "stuck", "swapped", "splits")}
)
AMOUNTS: Mapping[str, Setter] = MappingProxyType(
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
EVENTS: Mapping[str, Setter] = MappingProxyType(
    {
        "unplug": lambda faults, _: faults.unplug(),
        "replug": lambda faults, _: faults.replug(),
        "clear": lambda faults, _: faults.clear(),
        "drop": lambda faults, value: faults.drop_next(round(value)),
    }
)


@dataclass(frozen=True)
class Vocabulary:
    """The faults of one kind of device. Amounts need a number, and so do some events; ``words`` name one instead."""

    switches: Mapping[str, Setter]
    amounts: Mapping[str, Setter]
    events: Mapping[str, Setter]
    counted: Collection[str] = ()
    probabilities: Collection[str] = ()
    signed: Collection[str] = ()
    words: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    line_only: Collection[str] = ()

    def setter(self, name: str) -> Setter:
        """Return what a fault does to the link."""
        return {**self.switches, **self.amounts, **self.events}[name]


HEADS = Vocabulary(
    SWITCHES,
    AMOUNTS,
    {**EVENTS, "reset": device_does, "alarm": device_does},
    counted=("drop", "alarm"),
    probabilities=("garble", "lose", "insert", "bursts"),
    line_only=(
        *("unplug", "replug", "echo", "echo_bytes", "echo_delay", "stuck", "swapped", "splits"),
        *("lose", "insert", "bursts", "garble"),
    ),
)


@dataclass(frozen=True, slots=True)
class Happening:
    """One thing that happens; ``head`` is None for the whole line."""

    stamp_s: float
    name: str
    value: float
    head: str | None
    setter: Setter

    def set(self, faults: Faults) -> None:
        """Make it so."""
        self.setter(faults, self.value)


class FaultScript:
    """What is to happen, in order."""

    def __init__(self, happenings: Iterable[Happening]) -> None:
        self._ahead = deque(sorted(happenings, key=lambda happening: happening.stamp_s))

    @classmethod
    def parse(cls, text: str, start_s: float, heads: Collection[str], known: Vocabulary = HEADS) -> FaultScript:
        """Read a script whose second 0 is ``start_s``; raises InputError that names the statement."""
        found: list[Happening] = []
        for line in text.splitlines():
            for statement in line.partition("#")[0].split(";"):
                if statement.strip():
                    found += _parse(statement.strip(), start_s, heads, known)
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


def _parse(statement: str, start_s: float, heads: Collection[str], known: Vocabulary) -> list[Happening]:
    match = _STATEMENT.fullmatch(statement)
    if match is None:
        on_head = " [on HEAD]" if heads else ""
        raise _wrong(statement, f"write 'at SECONDS FAULT' or 'from SECONDS to SECONDS{on_head} FAULT [NUMBER]'")
    name, head, spans = match["name"], match["head"], match["at"] is None
    allowed = {**known.switches, **known.amounts, **({} if spans else known.events)}
    if name not in allowed:
        raise _wrong(statement, f"'{name}' is none of {', '.join(sorted(allowed))}")
    if head is not None and not heads:
        raise _wrong(statement, f"there is one device only: leave out 'on {head}'")
    if head is not None and head not in heads:
        raise _wrong(statement, f"there is no head '{head}', but {', '.join(sorted(heads))}")
    if head is not None and name in known.line_only:
        raise _wrong(statement, f"{name} happens to the line, not to one head: leave out 'on {head}'")
    value = _value(statement, name, match["value"], known)
    try:
        stamps = [float(match[key]) for key in (("first", "last") if spans else ("at",))]
    except ValueError:
        raise _wrong(statement, "a number is written like 2 or 2.5") from None
    if spans and stamps[1] <= stamps[0]:
        raise _wrong(statement, "it ends before it begins")
    setter = known.setter(name)
    begin = Happening(start_s + stamps[0], name, value, head, setter)
    return [begin, Happening(start_s + stamps[1], name, 0.0, head, setter)] if spans else [begin]


def _value(statement: str, name: str, text: str | None, known: Vocabulary) -> float:
    if name in known.words:
        words = known.words[name]
        if text is None or text.lower() not in words:
            raise _wrong(statement, f"{name} needs one of {', '.join(words)}")
        return words[text.lower()]
    needs = name in known.amounts or name in known.counted
    if (text is None) == needs:
        raise _wrong(statement, f"{name} {'needs a number' if needs else 'takes no number'}")
    try:
        value = float(text or 1.0)
    except ValueError:
        raise _wrong(statement, "a number is written like 2 or 2.5") from None
    if name in known.probabilities and value > 1.0:
        raise _wrong(statement, f"{name} takes a probability, 0 to 1")
    if value < 0.0 and name not in known.signed:
        raise _wrong(statement, f"{name} takes no number below 0")
    return value


def _wrong(statement: str, why: str) -> InputError:
    return InputError(f"fault script: '{statement}': {why}")
