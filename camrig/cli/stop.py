"""``camrig stop``: tells every head of a rig to stop, whatever became of the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.console import people
from camrig.config.rig_file import load_rig
from camrig.errors import PartialError
from camrig.runtime.stop_heads import stop_heads


def stop(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
) -> None:
    """Write stop to every head of a rig and exit; moves nothing, needs no daemon (systemd runs it after one)."""
    unreached = stop_heads(load_rig(config))
    for name, reason in unreached.items():
        people.print(f"{name}: {reason}", soft_wrap=True, markup=False, highlight=False)
    if unreached:
        raise PartialError(f"no stop could be written to {', '.join(sorted(unreached))}")
