"""``camrig devices``: what is plugged in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, cast

import typer
from rich.markup import escape
from rich.table import Table

from camrig.cli.console import people, print_json, results
from camrig.host.plugged_in import Device, plugged_in


def devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List cameras with their names, modes and controls, and the serial ports that heads may hang on. Moves nothing."""
    with people.status("asking what is plugged in"):
        found = plugged_in()
    if as_json:
        print_json({"cameras": [_told(device) for device in found.cameras], "ports": list(map(_told, found.ports))})
        return
    for camera in found.cameras:
        results.print(_camera(camera))
    if found.ports:
        results.print(_ports(found.ports))
    for kind, listed in (("camera", found.cameras), ("serial port", found.ports)):
        if not listed:
            results.print(f"No {kind} is plugged in.")


def _told(device: Device) -> dict[str, object]:
    found = device.found
    return {
        "name": found.name,
        "title": found.title,
        "drivers": list(device.drivers),
        "section": found.section,
        "trouble": found.trouble or None,
        **found.facts,
    }


def _camera(device: Device) -> Table:
    found = device.found
    table = Table(title=f"Camera {escape(found.title)}", title_justify="left", show_header=False)
    table.add_row("name it", escape(found.name))
    others = [name for name in _texts(found.facts.get("names")) if name != found.name]
    if others:
        table.add_row("or", escape("\n".join(others)))
    if found.facts.get("serial"):
        table.add_row("serial", escape(str(found.facts["serial"])))
    if found.trouble:
        table.add_row("trouble", f"[red]{escape(found.trouble)}[/red]")
    modes, controls = "\n".join(_modes(found.facts.get("modes"))), "\n".join(_controls(found.facts.get("controls")))
    for title, text in (("modes", modes), ("controls", controls)):
        if text:
            table.add_row(title, escape(text))
    return table


def _modes(modes: object) -> Iterator[str]:
    """Yield a line for each format: its sizes, each with its fastest rate."""
    sizes: dict[str, list[str]] = {}
    for mode in cast("Sequence[Mapping[str, object]]", modes or ()):
        rates = cast("Sequence[float]", mode["fps"])
        fastest = f" at {rates[0]:g} fps" if rates else ""
        sizes.setdefault(str(mode["format"]), []).append(f"{mode['size_px']}{fastest}")
    yield from (f"{pixels}: {', '.join(listed)}" for pixels, listed in sizes.items())


def _controls(controls: object) -> Iterator[str]:
    """Yield a line for each control: what it may be, and what it is."""
    for name, control in cast("Mapping[str, Mapping[str, object]]", controls or {}).items():
        value = control.get("value")
        match control:
            case {"kind": "number", "minimum": low, "maximum": high}:
                allowed = f"{low} to {high}"
            case {"kind": "menu", "items": listed}:
                items = cast("Mapping[str, int]", listed)
                allowed = ", ".join(items)
                value = next((item for item, number in items.items() if number == value), value)
            case _:
                allowed, value = "true, false", str(value).lower()
        notes = [word for key, word in (("read_only", "read only"), ("governed", "automatic now")) if control.get(key)]
        yield f"{name} = {value} ({'; '.join([allowed, *notes])})"


def _ports(ports: Sequence[Device]) -> Table:
    table = Table("port", "what", "drivers", "trouble", title="Serial ports", title_justify="left")
    for device in ports:
        found = device.found
        trouble = f"[red]{escape(found.trouble)}[/red]"
        table.add_row(escape(found.name), escape(found.title), ", ".join(device.drivers), trouble)
    return table


def _texts(names: object) -> list[str]:
    return [str(name) for name in cast("Sequence[object]", names or ())]
