"""``camrig run``: the daemon in the foreground; systemd starts exactly this."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.logging import RichHandler
from rich.table import Table

from camrig.cli.console import people, print_json
from camrig.config.rig_file import load_rig
from camrig.config.settings import settings_of
from camrig.report.spread import SpreadSink
from camrig.runtime.daemon import Daemon
from camrig.runtime.emulated import emulated_world
from camrig.runtime.operator import Operator
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_socket import claimed, runtime_folder
from camrig.runtime.operator_status import RecentEvents


def run(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
    seconds: Annotated[float, typer.Option(min=0.0, help="Stop by itself after so long (0 = never).")] = 0.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="End with one JSON object: spread of static targets.")
    ] = False,
) -> None:
    """Run a rig until SIGTERM or SIGINT, or until every camera's recording has ended; then come to rest and exit 0."""
    log_to_stderr()
    spread, events = SpreadSink(), RecentEvents()
    loaded = load_rig(config)
    with claimed(loaded.rig.name, runtime_folder()) as listener, emulated_world(loaded) as (rig_config, _):
        daemon = Daemon(rig_config, settings_of(rig_config), extra_sinks=[spread, events])
        with stopped_by_signals(daemon):
            daemon.start()
            try:
                with serving(listener, Operator(daemon, events), daemon.request_stop):
                    daemon.supervise(daemon.clock.now_s() + seconds if seconds else float("inf"))
            finally:
                daemon.stop()
    if as_json:
        print_json({"spread": {name: asdict(found) for name, found in spread.spreads().items()}})
    else:
        people.print(*_spread_tables(spread))


@contextmanager
def stopped_by_signals(daemon: Daemon) -> Iterator[None]:
    """Have SIGTERM and SIGINT ask the daemon to stop while inside."""

    def ask(number: int, frame: FrameType | None) -> None:
        del number, frame
        daemon.request_stop()

    before = {number: signal.signal(number, ask) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def log_to_stderr(level: int = logging.INFO) -> None:
    """Send the log to standard error: rich for people, plain lines for the journal."""
    if people.is_terminal:
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
