"""``camrig emulate``: one emulated device on a real port, for other people's programs and tests."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Annotated, Any

import typer
import yaml
from pydantic import BaseModel
from pydantic_core import to_json
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from camrig import plugins
from camrig.cli.console import people, print_json, results
from camrig.cli.signals import asked_to_stop
from camrig.clock import RealClock
from camrig.config.document import Document
from camrig.errors import ConfigError, InputError
from camrig.interfaces import Emulator

REFRESH_S = 0.25


def emulate(
    device: Annotated[str, typer.Argument(help="What to emulate: pelco-d, visca or drone.")],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="What it is like; see --settings. Values as in YAML."),
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.0, help="Stop by itself after so long (0 = never).")] = 0.0,
    show_settings: Annotated[bool, typer.Option("--settings", help="List the keys and their defaults.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the port, and at the end the state, as JSON.")] = False,
) -> None:
    """Run one emulated device until Ctrl-C: `camrig emulate drone flavour=px4 script='at 20 no_pose'`."""
    plugin = plugins.load_plugin("emulators", device)
    if show_settings:
        results.print(_settings_table(device, plugin.section))
        return
    emulator: Emulator = plugin.make(_section(device, plugin.section, settings or []))
    with asked_to_stop() as asked:
        try:
            port = emulator.start()
            if as_json:
                print_json({"emulator": device, "port": port})
            else:
                results.print(port, soft_wrap=True, highlight=False, markup=False)
            lasted_s = _watch(emulator, asked, seconds)
            if as_json:
                print_json({"emulator": device, "seconds": round(lasted_s, 3), "state": emulator.describe()})
        finally:
            emulator.stop()


def _watch(emulator: Emulator, asked: threading.Event, seconds: float) -> float:
    """Show the emulator's state to people until it is to stop; return how long that took."""
    clock = RealClock()
    start_s = clock.now_s()
    if people.is_terminal:
        with Live(emulator.describe(), console=people, auto_refresh=False) as live:
            while not asked.wait(REFRESH_S) and not 0.0 < seconds <= clock.now_s() - start_s:
                live.update(emulator.describe(), refresh=True)
    else:
        asked.wait(seconds or None)
    return clock.now_s() - start_s


def _section(device: str, model: type[BaseModel], settings: Sequence[str]) -> BaseModel:
    """Return the checked section; raises ConfigError with everything that is wrong with the settings."""
    data = dict(_key_and_value(setting) for setting in settings)
    document = Document(f"camrig emulate {device}", data, {(): 0, **{(key,): 0 for key in data}})
    section, faults = document.validate(model, data)
    if section is None:
        raise ConfigError(faults)
    return section


def _key_and_value(setting: str) -> tuple[str, Any]:
    key, separator, text = setting.partition("=")
    if not (key and separator):
        raise InputError(f"'{setting}' is no setting: write KEY=VALUE, as in baud=2400; --settings lists the keys")
    try:
        return key, yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"'{setting}': the value is no YAML: {' '.join(str(error).split())}") from error


def _settings_table(device: str, model: type[BaseModel]) -> Table:
    table = Table("key", "default", "meaning", title=f"camrig emulate {device} [KEY=VALUE]...")
    for name, field in model.model_fields.items():
        default = "" if field.is_required() else to_json(field.default).decode()
        table.add_row(name, default, escape(field.description or ""))
    return table
