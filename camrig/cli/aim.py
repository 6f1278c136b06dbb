"""``camrig aim``: send one head somewhere and wait until it is there, or only watch where it points."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.live import Live

from camrig.cli.aim_watch import Look, Verdict, judge, look_at
from camrig.cli.console import people, print_json, results
from camrig.cli.operating import RigOption, SocketOption, socket_of
from camrig.cli.signals import INTERRUPTED, asked_to_stop
from camrig.clock import Clock, RealClock
from camrig.errors import HardwareError
from camrig.report.terminal_head import head_view
from camrig.runtime.operator_client import ask

LOOK_S = 0.1
WATCH_S = 0.25


def aim(
    head: Annotated[str, typer.Argument(help="The head's id.")],
    pan_deg: Annotated[
        float | None, typer.Option(help="Where to, positive to the left; not given: as it is.", show_default=False)
    ] = None,
    tilt_deg: Annotated[
        float | None, typer.Option(help="Where to, positive up; not given: as it is.", show_default=False)
    ] = None,
    tolerance_deg: Annotated[float, typer.Option(min=0.01, max=10.0, help="How near counts as there.")] = 0.3,
    timeout_s: Annotated[float, typer.Option(min=0.1, max=3600.0, help="How long to wait for it to be there.")] = 30.0,
    rig: RigOption = None,
    socket: SocketOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object; watching: one each look.")] = False,
) -> None:
    """Send one head of a running rig somewhere, show where it points, and wait until it is there.

    No plan moves that head any more before `camrig resume`. Without --pan-deg and --tilt-deg nothing is moved: it only
    shows where the head points, until Ctrl-C.
    """
    path = socket_of(rig, socket)
    if pan_deg is None and tilt_deg is None:
        _watch(path, head, as_json)
        return
    wanted = {key: value for key, value in (("pan_deg", pan_deg), ("tilt_deg", tilt_deg)) if value is not None}
    ordered = ask(path, {"command": "aim", "head": head, **wanted})
    target_deg = (float(str(ordered["pan_deg"])), float(str(ordered["tilt_deg"])))
    with asked_to_stop() as asked, _picture(hidden=as_json) as show:
        verdict = _follow(path, head, target_deg, tolerance_deg, timeout_s, asked, show)
    if as_json:
        print_json(verdict.as_json())
    if verdict.reason is None:
        people.print(f"{head} goes on to its aim; `camrig hold` stops it", highlight=False)
        raise typer.Exit(INTERRUPTED)
    if not verdict.arrived:
        raise HardwareError(f"{head} is not there: {verdict.reason}")
    if not as_json:
        back = f"`camrig resume {head}` gives it back to the plans"
        results.print(f"{head}: {verdict.reason}; {back}", soft_wrap=True, markup=False, highlight=False)


def _follow(
    path: Path,
    head: str,
    target_deg: tuple[float, float],
    tolerance_deg: float,
    timeout_s: float,
    asked: threading.Event,
    show: Callable[[Look], None],
) -> Verdict:
    """Look at the head until there is a verdict; its reason is None where a signal came first."""
    clock: Clock = RealClock()
    began_s = clock.now_s()
    looks: list[Look] = []
    while True:
        looks = [*looks[-20:], look_at(path, head)]
        show(looks[-1])
        lasted_s = clock.now_s() - began_s
        verdict = judge(looks, target_deg, tolerance_deg, lasted_s, timeout_s)
        if verdict is not None:
            return verdict
        if asked.wait(LOOK_S):
            return Verdict(head, looks[-1], target_deg, lasted_s, arrived=False, reason=None)


def _watch(path: Path, head: str, as_json: bool) -> None:
    """Show where a head points until a signal comes; without a terminal print it, once or as JSON lines."""
    with asked_to_stop() as asked, _picture(hidden=as_json) as show:
        while True:
            look = look_at(path, head)
            show(look)
            if as_json:
                print_json(look.as_json())
            elif not people.is_terminal:
                results.print(look.sentence(), soft_wrap=True, highlight=False, markup=False)
                return
            if asked.wait(WATCH_S):
                return


@contextmanager
def _picture(*, hidden: bool) -> Iterator[Callable[[Look], None]]:
    """Yield what shows a look to people; nothing where there is no terminal."""
    if hidden or not people.is_terminal:
        yield lambda _: None
        return
    with Live(console=people, auto_refresh=False) as live:
        yield lambda look: live.update(head_view(look.picture()), refresh=True)
