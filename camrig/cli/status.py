"""``camrig status``: how a running rig is."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from camrig.cli.console import print_json, results
from camrig.cli.operating import Answer, RigOption, SocketOption, names, order, part, parts

EVENTS_SHOWN = 5
LATE_SHOWN_S = 0.015
_CONTROLS = {"planner": "enabled", "operator": "aimed by an operator", "held": "held"}
_CONTROLS_OF_DRONES = {"planner": "follows plans", "held": "held", "nobody": "not commanded"}
_UNITS_S = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"))
_COLOURS = {"up": "green", "tracked": "green", "lost": "red", "unseen": "yellow", "closed": "yellow"}


def status(
    rig: RigOption = None,
    socket: SocketOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show how a running rig is: targets, devices and their links, the plan, what was said last."""
    answer = order(rig, socket, "status")
    if as_json:
        print_json(answer)
        return
    results.print(_headline(answer), highlight=False)
    results.print(_targets(answer), _devices(answer))
    for line in _troubles(part(answer, "drones")):
        results.print(line, highlight=False)
    for event in parts(answer, "events")[-EVENTS_SHOWN:]:
        about, text = escape(str(event.get("about"))), escape(str(event.get("text")))
        results.print(f"[dim]{_seconds(event.get('age_s'))} ago[/dim] {about}: {text}", highlight=False)


def _headline(answer: Answer) -> str:
    targets = part(answer, "targets")
    tracked = sum(part(targets, name).get("status") == "tracked" for name in targets)
    text = f"[bold]{escape(str(answer.get('rig')))}[/bold]: {answer.get('phase')}, {tracked} of {len(targets)} targets"
    plan = part(answer, "plan")
    if not plan:
        return f"{text}; no plan yet"
    uncovered = f", not covered: {escape(names(plan, 'uncovered'))}" if plan.get("uncovered") else ""
    return f"{text}; plan {plan.get('status')}{uncovered}, {_seconds(plan.get('age_s'))} old"


def _targets(answer: Answer) -> Table:
    columns = ("x, y, z (m)", "sigma (mm)", "planned", "innovation", "seen by", "age (s)")
    table = Table("target", "status", *columns, title="Targets")
    targets = part(answer, "targets")
    for name in targets:
        target = part(targets, name)
        place = ", ".join(f"{value:.3f}" for value in _numbers(target, "position_m"))
        sigma, planned = (
            ", ".join(f"{1000.0 * value:.1f}" for value in _numbers(target, key))
            for key in ("sigma_m", "planned_sigma_m")
        )
        innovation = "".join(f"{value:.1f}" for value in _numbers(target, "innovation"))
        age = "".join(f"{value:.1f}" for value in _numbers(target, "age_s"))
        seen_by = names(target, "seen_by") if target.get("seen_by") else ""
        row = (place, sigma, planned, innovation, escape(seen_by), age)
        table.add_row(escape(name), _coloured(target.get("status")), *row)
    return table


def _devices(answer: Answer) -> Table:
    table = Table("device", "link", "state", "for", "lost", "answered", "reason", title="Devices")
    for kind in ("cameras", "heads", "drones"):
        devices = part(answer, kind)
        for name in devices:
            device = part(devices, name)
            state, reason = ", ".join(filter(None, _state(device))), escape(str(device.get("reason")))
            lost = f"{_counted(device, 'losses'):.0f}" if _counted(device, "losses") else ""
            counts = (_lasting(device.get("since_s")), lost, _answered(device))
            table.add_row(escape(name), _coloured(device.get("link")), state, *counts, reason)
    return table


def _state(device: Answer) -> Iterator[str]:
    """Yield what is known of a camera, a head or a drone."""
    yield from (f"{value:.1f} fps" for value in _numbers(device, "fps"))
    drift, late = part(device, "drift"), part(device, "head_late_s")
    if drift.get("alarming"):
        yield f"{_first(drift, 'turned_deg'):.2f} deg and {1e3 * _first(drift, 'moved_m'):.0f} mm off its calibration"
    if abs(_first(late, "mean")) > max(LATE_SHOWN_S, 5.0 * _first(late, "sigma")):
        yield f"its head reports {_first(late, 'mean'):+.3f} s late"
    if "enabled" in device:
        yield _CONTROLS.get(str(device.get("control")), "held")
    yield from (f"pan {value:.1f} deg" for value in _numbers(device, "pan_deg"))
    yield from (f"tilt {value:.1f} deg" for value in _numbers(device, "tilt_deg"))
    yield from (f"{value:.0f} Hz" for value in _numbers(device, "answers_hz"))
    if "flight" in device:
        yield str(device["flight"])
        yield _CONTROLS_OF_DRONES.get(str(device.get("control")), "")
        yield from (f"battery {value:.0f} %" for value in _numbers(device, "battery_percent"))
        if "fit" in device:
            yield "fit to fly" if device["fit"] else "not fit to fly"


def _troubles(drones: Answer) -> Iterator[str]:
    """Yield a line for every reason why a drone would not be armed or resumed now, and for what should be otherwise."""
    for name in drones:
        drone = part(drones, name)
        for key, colour, what in (("said", "yellow", ""), ("unfit", "red", "not fit: "), ("advice", "dim", "better: ")):
            found = drone.get(key)
            for text in found if isinstance(found, list) else [found] if found else []:
                yield f"[{colour}]{escape(f'{name}: {what}{text}')}[/{colour}]"


def _answered(device: Answer) -> str:
    """Return the share of a head's polls that brought a position, and how many there were."""
    polls = _counted(device, "polls")
    return f"{100.0 * _counted(device, 'answers') / polls:.1f} % of {polls:.0f}" if polls else ""


def _counted(device: Answer, key: str) -> float:
    return _first(part(device, "statistics"), key)


def _first(answer: Answer, key: str) -> float:
    return next(iter(_numbers(answer, key)), 0.0)


def _lasting(value: object) -> str:
    """Return a time in the unit that suits it."""
    if not isinstance(value, int | float):
        return ""
    return next((f"{value / size:.1f} {unit}" for size, unit in _UNITS_S if value >= size), f"{value:.0f} s")


def _numbers(answer: Answer, key: str) -> list[float]:
    """Return the number or numbers under a key; none where they are unknown."""
    found = answer.get(key)
    return [value for value in (found if isinstance(found, list) else [found]) if isinstance(value, int | float)]


def _seconds(value: object) -> str:
    return f"{value:.1f} s" if isinstance(value, int | float) else ""


def _coloured(value: object) -> str:
    colour = _COLOURS.get(str(value))
    return f"[{colour}]{value}[/{colour}]" if colour else escape(str(value))
