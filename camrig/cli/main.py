"""``camrig``: registers the commands, and turns every CamrigError into one message and its exit code."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module, metadata
from typing import Annotated

import typer
from rich.markup import escape

from camrig.cli.console import people, results
from camrig.errors import CamrigError

_COMMANDS = (
    "run",
    "check",
    "devices",
    "doctor",
    "init",
    "demo",
    "plan",
    "detect",
    "calibrate",
    "experiment",
    "emulate",
    "stop",
    "status",
    "hold",
    "resume",
    "aim",
    "arm",
    "takeoff",
    "land",
    "scan",
    "install-service",
)
"""Each is a module of this package (- is _) with a function of its name, or with a program of commands of its own."""


def build(commands: Sequence[str] = _COMMANDS) -> typer.Typer:
    """Return the program with these commands."""
    app = typer.Typer(
        name="camrig",
        help="Aims pan-tilt and drone cameras so that all targets together are sensed as well as possible.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",
    )
    app.callback()(_no_command)  # a program of one command would otherwise not be asked for it by name
    for name in commands:
        command = getattr(import_module(f"camrig.cli.{_module(name)}"), _module(name))
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def _module(command: str) -> str:
    return command.replace("-", "_")


def _print_version(asked: bool) -> None:
    if asked:
        results.print(f"camrig {metadata.version('camrig')}", highlight=False)
        raise typer.Exit


def _no_command(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Do nothing: every command stands for itself."""


def main() -> None:
    """Run the program; exit codes: 0 done, 2 bad input, 3 hardware or link, 4 partial, 130 interrupted."""
    named = [name for name in sys.argv[1:2] if name in _COMMANDS]
    try:
        build(named or _COMMANDS)()  # the one alone is there in a fifth of the time, and `hold` is in a hurry
    except CamrigError as error:
        people.print(f"[red]error:[/red] {escape(str(error))}", soft_wrap=True, highlight=False)
        sys.exit(error.exit_code)
