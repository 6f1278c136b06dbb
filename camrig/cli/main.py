"""``camrig``: registers the commands, and turns every CamrigError into one message and its exit code."""

from __future__ import annotations

import sys
from importlib import import_module

import typer
from rich.markup import escape

from camrig.cli.console import people
from camrig.errors import CamrigError

_COMMANDS = (
    "run",
    "check",
    "demo",
    "plan",
    "detect",
    "emulate",
    "stop",
    "status",
    "hold",
    "resume",
    "arm",
    "land",
    "scan",
)
"""Each is a module of this package with a function of the same name."""


def build() -> typer.Typer:
    """Return the program with all its commands."""
    app = typer.Typer(
        name="camrig",
        help="Aims pan-tilt and drone cameras so that all targets together are sensed as well as possible.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",
    )
    for name in _COMMANDS:
        app.command(name)(getattr(import_module(f"camrig.cli.{name}"), name))
    return app


def main() -> None:
    """Run the program; exit codes: 0 done, 2 bad input, 3 hardware or link, 4 partial, 130 interrupted."""
    try:
        build()()
    except CamrigError as error:
        people.print(f"[red]error:[/red] {escape(str(error))}", soft_wrap=True, highlight=False)
        sys.exit(error.exit_code)
