"""Where targets of a real rig truly stand: a file of surveyed places."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from camrig.errors import ConfigError, Fault, InputError
from camrig.geometry.arrays import Array

COLUMNS = ("id", "x_m", "y_m", "z_m")


def load_surveyed(path: Path, targets: Collection[str]) -> Mapping[str, Array]:
    """Return the place (3,) m of every target in the world, by id.

    The file is CSV with the columns id, x_m, y_m, z_m. Raises InputError for one that cannot be read, ConfigError with
    all faults of one that does not place every target exactly once.
    """
    try:
        lines = list(csv.reader(path.read_text().splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {error}") from error
    if not lines or tuple(name.strip() for name in lines[0]) != COLUMNS:
        raise InputError(f"{path}: the first line names the columns: {','.join(COLUMNS)}")
    places: dict[str, Array] = {}
    faults = []
    for number, fields in enumerate(lines[1:], 2):
        name = fields[0].strip() if fields else ""
        if not name:
            continue
        place = _place(fields[1:])
        if name not in targets:
            faults.append(Fault(str(path), number, name, f"is no target of the rig; it has {', '.join(targets)}"))
        elif name in places:
            faults.append(Fault(str(path), number, name, "stands twice"))
        elif place is None:
            faults.append(Fault(str(path), number, name, "takes three numbers in metres: x_m, y_m, z_m"))
        else:
            places[name] = place
    named = set(places) | {fault.key for fault in faults}
    faults += [
        Fault(str(path), 0, name, "is a target of the rig and not surveyed") for name in targets if name not in named
    ]
    if faults:
        raise ConfigError(faults)
    return places


def _place(fields: list[str]) -> Array | None:
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        return None
    return np.array(numbers) if len(numbers) == 3 and all(map(math.isfinite, numbers)) else None
