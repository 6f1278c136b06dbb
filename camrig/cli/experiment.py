"""``camrig experiment``: the paper's tables and ours, made again by anyone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import typer

from camrig.cli.choice import choice, choices
from camrig.cli.console import note, print_json, progress_bar
from camrig.cli.experiment_accuracy import accuracy
from camrig.cli.experiment_common import sizes_of, tell_left_out, write
from camrig.cli.experiment_model import model
from camrig.cli.experiment_table1 import table1
from camrig.cli.experiment_table2 import table2
from camrig.cli.signals import interrupting
from camrig.errors import InputError
from camrig.experiments import machine
from camrig.experiments.planner import MODES, SIZES, Clocks, SceneRun, Setup, able, run
from camrig.experiments.planner_report import REFERENCE, Report, as_json, as_markdown
from camrig.messages import RigPlan
from camrig.optimise.scene import Objective, Quality, Scene, Visibility
from camrig.optimise.solvers import SOLVERS
from camrig.report.plan_map import check_picture, plan_panel

_PANELS_OF_A_MODE = 3

experiment = typer.Typer(
    help="Make a table of the paper's or of ours again.", no_args_is_help=True, rich_markup_mode="markdown"
)


@experiment.callback()
def _no_experiment() -> None:
    """Do nothing: every experiment stands for itself."""


@experiment.command()
def planner(
    sizes: Annotated[str, typer.Option(help="Cameras x targets, several with commas.")] = ",".join(
        f"{cameras}x{targets}" for cameras, targets in SIZES
    ),
    modes: Annotated[str, typer.Option(help="ptz, drone or both.")] = ",".join(MODES),
    runs: Annotated[int, typer.Option(min=1, help="Random scenes of every mode and size.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene; the next one's is one more.")] = 0,
    solvers: Annotated[str | None, typer.Option(help=f"Some of {','.join(SOLVERS)}; all where not given.")] = None,
    visibility: Annotated[str, typer.Option(help="cone (the paper's) or image (the true picture).")] = "cone",
    objective: Annotated[str, typer.Option(help="mean over the covered targets, or the worst of them.")] = "mean",
    quality: Annotated[str, typer.Option(help="pixel (the paper's), fisher or perspective.")] = "pixel",
    out: Annotated[Path | None, typer.Option(help="Write the Markdown here.")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw camrig's plans of some scenes to this .svg or .png.")
    ] = None,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object, with every scene.")] = False,
) -> None:
    """Compare all solvers on the same random scenes. Set OMP_NUM_THREADS=1: the figures are of one thread."""
    asked = Setup(
        sizes=sizes_of(sizes),
        modes=choices("--modes", modes, MODES),
        runs=runs,
        seed=seed,
        solvers=SOLVERS if solvers is None else choices("--solvers", solvers, SOLVERS),
        visibility=choice("--visibility", visibility, get_args(Visibility)),
        objective=choice("--objective", objective, get_args(Objective)),
        quality=choice("--quality", quality, get_args(Quality)),
    )
    _check_files(asked, out, picture)
    report = _report(asked, hidden=as_json_object)
    if out is not None:
        write(out, as_markdown(report))
    if picture is not None:
        plan_panel(picture, _panels(report.scenes))
    if as_json_object:
        print_json(as_json(report))
    elif out is None:
        typer.echo(as_markdown(report), nl=False)
    tell_left_out(report.left_out.values(), by_name=solvers is not None)


def _check_files(asked: Setup, out: Path | None, picture: Path | None) -> None:
    """Raise InputError for what cannot be written: before anything is run for it."""
    if out is not None and (out.is_dir() or not out.parent.is_dir()):
        raise InputError(f"{out}: --out takes a file in a folder that is there")
    if picture is not None:
        check_picture(picture)
        if REFERENCE not in asked.solvers:
            raise InputError(f"--picture draws the plans of {REFERENCE}: name it among the --solvers")


def _report(asked: Setup, *, hidden: bool) -> Report:
    """Run it all, with a progress bar."""
    setup, left_out = able(asked)
    if not setup.solvers:
        raise InputError("\n".join(left_out.values()))
    about = machine.machine()
    if about["omp_num_threads"] != "1":
        note(f"{machine.THREADS} is not 1: linear algebra may use several threads")
    scenes = []
    bar = progress_bar("planning", setup.scenes, hidden=hidden)
    with bar as progress, interrupting(time.perf_counter) as wall_s:
        for scene in run(setup, Clocks(wall_s, time.process_time)):
            scenes.append(scene)
            progress.advance(progress.task_ids[0])
    return Report(setup, _command(asked), about, machine.versions(), left_out, scenes)


def _command(asked: Setup) -> str:
    """Return the command that makes the same table: what is limited by the environment, and every option."""
    options: dict[str, object] = {
        "sizes": ",".join(f"{cameras}x{targets}" for cameras, targets in asked.sizes),
        "modes": ",".join(asked.modes),
        "runs": asked.runs,
        "seed": asked.seed,
        "visibility": asked.visibility,
        "objective": asked.objective,
        "quality": asked.quality,
    }
    if asked.solvers != SOLVERS:
        options["solvers"] = ",".join(asked.solvers)
    words = " ".join(f"--{name} {value}" for name, value in options.items())
    return f"{machine.THREADS}=1 camrig experiment planner {words}"


def _panels(scenes: Sequence[SceneRun]) -> list[tuple[str, Scene, RigPlan]]:
    """Return the first scene of up to three sizes of each mode, as the reference has planned them."""
    chosen: list[SceneRun] = []
    for mode in MODES:
        sizes: dict[tuple[int, int], SceneRun] = {}
        for each in scenes:
            if each.place.mode == mode:
                sizes.setdefault((each.place.cameras, each.place.targets), each)
        firsts = list(sizes.values())
        count = min(len(firsts), _PANELS_OF_A_MODE)
        chosen += [firsts[round(k)] for k in np.linspace(0, len(firsts) - 1, count)]
    return [
        (f"{place.mode} {place.cameras}x{place.targets}, seed {place.seed}", each.scene, each.answers[REFERENCE].plan)
        for each in chosen
        for place in (each.place,)
    ]


experiment.command()(table1)
experiment.command()(model)
experiment.command()(table2)
experiment.command()(accuracy)
