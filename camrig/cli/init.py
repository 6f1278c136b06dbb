"""``camrig init``: a first YAML file from what is plugged in."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.console import people, results
from camrig.config.rig_file import load_rig
from camrig.errors import InputError
from camrig.host.first_rig import first_rig
from camrig.host.plugged_in import plugged_in


def init(
    file: Annotated[Path, typer.Argument(help="Where to write it; a file that is there is left alone.")] = Path(
        "rig.yaml"
    ),
) -> None:
    """Write one commented rig file from what is plugged in; what it cannot know says MEASURE or CALIBRATE."""
    with people.status("asking what is plugged in"):
        found = plugged_in()
    name = re.sub(r"[^a-z0-9_-]+", "-", file.stem.lower()).strip("-") or "rig"
    try:
        with file.open("x", encoding="utf-8") as new:
            new.write(first_rig(found, name))
    except FileExistsError as error:
        raise InputError(f"{file} exists and is left alone; name another file, or move it away first") from error
    except OSError as error:
        raise InputError(
            f"{file} cannot be written: {error.strerror}; name a file in a folder that is yours"
        ) from error
    load_rig(file)
    says = f"{file}: {len(found.cameras)} cameras and {len(found.ports)} serial ports found."
    todo = f"Measure and calibrate what it says, then `camrig check {file}`."
    results.print(f"{says} {todo}", soft_wrap=True, markup=False, highlight=False)
