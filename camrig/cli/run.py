"""``camrig run``: the daemon in the foreground; systemd starts exactly this."""

from __future__ import annotations

import logging
import signal
import socket
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Protocol

import typer
from rich.logging import RichHandler
from rich.table import Table

from camrig.cli.console import people, print_json
from camrig.cli.signals import on_signals
from camrig.config.rig_file import load_rig
from camrig.outputs.journal import JournalHandler, journal_behind
from camrig.report.spread import SpreadSink
from camrig.runtime.daemon import Daemon
from camrig.runtime.operator import Operator
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_socket import claimed, runtime_folder
from camrig.runtime.operator_status import RecentEvents
from camrig.runtime.reload import Run


def run(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
    seconds: Annotated[float, typer.Option(min=0.0, help="Stop by itself after so long (0 = never).")] = 0.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="End with one JSON object: spread of static targets.")
    ] = False,
) -> None:
    """Run a rig until SIGTERM or SIGINT, or until every camera's recording has ended; then come to rest and exit 0.

    SIGHUP reads the file again: where it has faults they are said and the rig runs on as it was, else the heads are
    stopped and the new configuration is started.
    """
    log_to_stderr()
    spread, events = SpreadSink(), RecentEvents()
    loaded = load_rig(config)
    folder = runtime_folder()
    with claimed(loaded.rig.name, folder) as listener:
        rig = Run(config, loaded, [spread, events], lambda daemon: _serving(listener, daemon, events), kept_in=folder)
        with stopped_by_signals(rig), reloaded_by_signals(rig):
            rig.until(rig.clock.now_s() + seconds if seconds else float("inf"))
    if as_json:
        print_json({"spread": {name: asdict(found) for name, found in spread.spreads().items()}})
    else:
        people.print(*_spread_tables(spread))


def _serving(listener: socket.socket, daemon: Daemon, events: RecentEvents) -> AbstractContextManager[None]:
    # A descriptor of its own, which the server closes: whoever connects during a reload waits for the next daemon.
    return serving(listener.dup(), Operator(daemon, events), daemon.request_stop)


class Stoppable(Protocol):
    """What can be asked to stop."""

    def request_stop(self) -> None:
        """Ask, from a signal handler too."""
        ...


def stopped_by_signals(running: Stoppable) -> AbstractContextManager[None]:
    """Have SIGTERM and SIGINT ask for a stop while inside."""
    return on_signals((signal.SIGTERM, signal.SIGINT), running.request_stop)


def reloaded_by_signals(run: Run) -> AbstractContextManager[None]:
    """Have SIGHUP ask for a reload while inside."""
    return on_signals((signal.SIGHUP,), run.request_reload)


def log_to_stderr(level: int = logging.INFO) -> None:
    """Send the log to standard error, or to the journal where that is behind it, with fields to ask for."""
    if journal_behind(2):
        logging.basicConfig(level=level, format="%(message)s", handlers=[JournalHandler()])
    elif people.is_terminal:
        handler: logging.Handler = RichHandler(console=people, show_path=False)
        logging.basicConfig(level=level, format="%(message)s", datefmt="[%X]", handlers=[handler])
    else:
        logging.basicConfig(level=level, format="%(levelname)s %(message)s")


def _spread_tables(sink: SpreadSink) -> list[Table]:
    table = Table("static target", "n", "x, y, z (m)", "rms (mm)", "median (mm)", title="Spread of single sightings")
    for name, spread in sorted(sink.spreads().items()):
        place = ", ".join(f"{value:.3f}" for value in spread.mean_m)
        scatter = (f"{value * 1000:.1f}" if spread.n > 1 else "" for value in (spread.rms_m, spread.median_m))
        table.add_row(name, str(spread.n), place, *scatter)
    return [table] if table.row_count else []
