"""Options that take one of some words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from camrig.errors import InputError

ChoiceT = TypeVar("ChoiceT", bound=str)


def choice(option: str, value: str, allowed: Sequence[ChoiceT]) -> ChoiceT:
    """Return the allowed word that was given; raises InputError, which names them all, for another one."""
    for each in allowed:
        if value == each:
            return each
    raise InputError(f"{option} takes {' or '.join(allowed)}, not '{value}'")


def choices(option: str, values: str, allowed: Sequence[ChoiceT]) -> tuple[ChoiceT, ...]:
    """Return the allowed words that were given with commas between them, each once."""
    return tuple(dict.fromkeys(choice(option, value.strip(), allowed) for value in values.split(",")))
