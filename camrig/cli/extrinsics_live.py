"""``camrig calibrate extrinsics --live``: the rig's own cameras look, its heads turn, after asking."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import typer

from camrig.calibrate.sighted import Shot
from camrig.calibrate.stops import stops_over
from camrig.cli.agreed import agreed
from camrig.cli.console import people, progress_bar
from camrig.cli.refinement import load_refinement
from camrig.cli.signals import INTERRUPTED, asked_to_stop
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig
from camrig.rig import FixedMount, HeadMount, Rig
from camrig.runtime.emulated import emulated_world
from camrig.runtime.head_bench import Interrupted
from camrig.runtime.rig_survey import RigSurvey

Stops = Mapping[str, Sequence[tuple[float, float]]]


def seeing(rig: Rig) -> dict[str, str]:
    """Return the cameras that are fixed or on a head."""
    return {name: "live" for name, camera in rig.cameras.items() if isinstance(camera.mount, FixedMount | HeadMount)}


def look_round(config: RigConfig, *, yes: bool, hidden: bool) -> tuple[list[Shot], list[str]]:
    """Ask, move, and return what all cameras saw of what stands, with a sentence for each that failed."""
    stops = {
        camera.mount.head: stops_over(head.pan_limits_rad, head.tilt_limits_rad, camera.lens)
        for camera in config.rig.cameras.values()
        if isinstance(camera.mount, HeadMount) and (head := config.rig.heads[camera.mount.head])
    }
    if stops:
        agreed(_motions(config.rig, stops), list(stops), yes=yes)
    if config.refine:
        load_refinement()
    total = sum(map(len, stops.values())) + sum(
        isinstance(camera.mount, FixedMount) for camera in config.rig.cameras.values()
    )
    with (
        emulated_world(config) as (running, _),
        asked_to_stop() as asked,
        progress_bar("looking round", total, hidden=hidden) as progress,
    ):

        def tell(what: str) -> None:
            progress.update(progress.task_ids[0], description=what, advance=1)

        try:
            return RigSurvey(running, RealClock(), stops, asked.is_set, tell).shots()
        except Interrupted:
            people.print("heads are stopped; nothing was written", highlight=False)
            raise typer.Exit(INTERRUPTED) from None


def _motions(rig: Rig, stops: Stops) -> Iterator[str]:
    """Say what will move, and how far."""
    for name, aims in stops.items():
        head = rig.heads[name]
        pan, tilt = (
            "{:.0f} to {:.0f}".format(*map(math.degrees, limits))
            for limits in (head.pan_limits_rad, head.tilt_limits_rad)
        )
        yield f"{name} will go to {len(aims)} aims, pan {pan} deg, tilt {tilt} deg"
