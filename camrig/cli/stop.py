"""``camrig stop``: tells every head of a rig to stop, whatever became of the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.console import people
from camrig.config.rig_file import RigConfig, load_rig
from camrig.errors import ConfigError, PartialError
from camrig.runtime.last_run import last_run
from camrig.runtime.stop_heads import stop_heads


def stop(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
) -> None:
    """Write stop to every head of a rig and exit; moves nothing, needs no daemon (systemd runs it after one).

    Where a daemon runs the rig or has died, the heads that it knew are stopped first, and then those of the file,
    should that have been changed since.
    """
    ran = last_run(config)
    try:
        written = load_rig(config)
    except ConfigError as faults:
        if ran is None:
            raise
        _stop_all([ran])
        raise PartialError(
            f"the heads were stopped as the daemon last knew them, for the file has faults now:\n{faults}"
        ) from faults
    _stop_all([written] if ran is None or ran.text == written.text else [ran, written])


def _stop_all(configs: list[RigConfig]) -> None:
    unreached: set[str] = set()
    for each in configs:
        troubles = stop_heads(each)
        for name, reason in troubles.items():
            people.print(f"{name}: {reason}", soft_wrap=True, markup=False, highlight=False)
        unreached |= troubles.keys()
    if unreached:
        raise PartialError(f"no stop could be written to {', '.join(sorted(unreached))}")
