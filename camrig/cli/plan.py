"""``camrig plan``: plans scenes off line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, get_args

import typer
from rich.table import Table

from camrig.cli.choice import choice
from camrig.cli.console import print_json, progress_bar, results
from camrig.cli.kernels import load_kernels
from camrig.cli.signals import interrupting
from camrig.clock import RealClock
from camrig.config.scene import SceneFile, load_scene
from camrig.errors import ConfigError, Fault, InputError, PartialError
from camrig.messages import Aim, HeadAim, PlanStatus, RigPlan
from camrig.optimise.scene import FixedPlace, Objective, Quality, Visibility
from camrig.optimise.solvers import SOLVERS, Solver, solve
from camrig.report.plan_map import QUALITY_UNITS, check_picture, write_plan_map


def plan(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="The scenes' YAML files.")],
    quality: Annotated[str | None, typer.Option(help="pixel (the paper's), fisher or perspective.")] = None,
    visibility: Annotated[str | None, typer.Option(help="cone (the paper's) or image (the true picture).")] = None,
    objective: Annotated[str | None, typer.Option(help="mean over the covered targets, or the worst of them.")] = None,
    solver: Annotated[
        str, typer.Option(help=f"{', '.join(SOLVERS)}: camrig's own or one to compare it with.")
    ] = "camrig",
    deadline_s: Annotated[float | None, typer.Option(help="Seconds a scene may take; the best so far counts.")] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed gives the same plan.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the (single) plan to this .svg or .png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a scene.")] = False,
) -> None:
    """Find where every camera of a scene should look or hover. Exit code 4 where a target stays uncovered."""
    planner = choice("--solver", solver, SOLVERS)
    if deadline_s is not None and not deadline_s > 0.0:
        raise InputError(f"--deadline-s must be above 0, not {deadline_s:g}")
    if picture is not None and len(scenes) > 1:
        raise InputError("--picture draws one scene; give a single SCENE with it")
    if picture is not None:
        check_picture(picture)
    model = None if quality is None else choice("--quality", quality, get_args(Quality))
    files = [_override(file, visibility, objective, deadline_s, seed) for file in _load(scenes, model)]
    plans, failures = _plan_all(files, planner, as_json)
    if picture is not None and plans:
        write_plan_map(picture, files[0].name, files[0].scene, plans[0])
    if failures:
        raise (PartialError if plans else InputError)("\n".join(failures))
    if any(found.status is not PlanStatus.OPTIMISED for found in plans):
        raise typer.Exit(PartialError.exit_code)


def _load(paths: Sequence[Path], quality: Quality | None) -> list[SceneFile]:
    """Read all scenes before any is planned; raises ConfigError with the faults of all files."""
    files: list[SceneFile] = []
    faults: list[Fault] = []
    for path in paths:
        try:
            files.append(load_scene(path, quality))
        except ConfigError as error:
            faults += error.faults
    if faults:
        raise ConfigError(faults)
    return files


def _override(
    file: SceneFile,
    visibility: str | None,
    objective: str | None,
    deadline_s: float | None,
    seed: int | None,
) -> SceneFile:
    """Put the command line's flags over the file's ``planner`` section."""
    given = file.scene.settings
    settings = replace(
        given,
        visibility=given.visibility if visibility is None else choice("--visibility", visibility, get_args(Visibility)),
        objective=given.objective if objective is None else choice("--objective", objective, get_args(Objective)),
    )
    return replace(
        file,
        scene=replace(file.scene, settings=settings),
        deadline_s=file.deadline_s if deadline_s is None else deadline_s,
        seed=file.seed if seed is None else seed,
    )


def _plan_all(files: Sequence[SceneFile], solver: Solver, as_json: bool) -> tuple[list[RigPlan], list[str]]:
    """Plan and show every scene; returns the plans, and a message for each scene that could not be planned."""
    clock = RealClock()
    load_kernels(files[0].scene.settings)
    plans: list[RigPlan] = []
    failures: list[str] = []
    bar = progress_bar("planning", len(files), hidden=as_json)
    with bar as progress, interrupting(clock.now_s) as now:
        for file in files:
            try:
                found = solve(solver, file.scene, deadline_s=file.deadline_s, seed=file.seed, now=now).plan
            except InputError as error:
                failures.append(f"{file.file}: {error}")
                if as_json:
                    print_json({"scene": file.name, "file": file.file, "error": str(error)})
            else:
                plans.append(found)
                if as_json:
                    print_json(_as_json(file, solver, found))
                else:
                    _print_tables(file, found)
            progress.advance(progress.task_ids[0])
    return plans, failures


def _as_json(file: SceneFile, solver: Solver, found: RigPlan) -> dict[str, object]:
    return {
        "scene": file.name,
        "file": file.file,
        "status": found.status.value,
        "objective_m": found.objective_m,
        "solver": solver,
        "solve_s": found.solve_s,
        "cameras": _cameras(file, found),
        "targets": {
            name: {"quality_m": target.quality_m, "seen_by": list(target.seen_by)}
            for name, target in found.targets.items()
        },
        "uncovered": list(found.uncovered),
        "seed": file.seed,
    }


def _cameras(file: SceneFile, found: RigPlan) -> dict[str, dict[str, object]]:
    """Return every camera's aim in degrees and metres, bolted cameras too."""
    aims: dict[str, dict[str, object]] = {}
    for camera in file.scene.cameras:
        if isinstance(camera.place, FixedPlace):
            axis = camera.place.T_world_camera[:3, 2]
            pan_rad, tilt_rad = math.atan2(axis[1], axis[0]), math.asin(max(-1.0, min(1.0, float(axis[2]))))
            aims[camera.id] = {"pan_deg": math.degrees(pan_rad), "tilt_deg": math.degrees(tilt_rad)}
        else:
            aims[camera.id] = _aim_as_json(found.aims[camera.id], found.mounts.get(camera.id))
    return aims


def _aim_as_json(aim: Aim, mount_m: tuple[float, float, float] | None) -> dict[str, object]:
    """Return an aim, with it where to mount a camera that is not mounted yet, and the zoom where the lens has one."""
    if not isinstance(aim, HeadAim):
        return {"position_m": list(aim.position_m), "yaw_deg": math.degrees(aim.yaw_rad)}
    where: dict[str, object] = {} if mount_m is None else {"position_m": list(mount_m)}
    zoom: dict[str, object] = {} if aim.zoom is None else {"zoom": aim.zoom}
    return where | {"pan_deg": math.degrees(aim.pan_rad), "tilt_deg": math.degrees(aim.tilt_rad)} | zoom


def _print_tables(file: SceneFile, found: RigPlan) -> None:
    settings = file.scene.settings
    unit = QUALITY_UNITS[settings.quality]
    cameras = Table("camera", "aim", "sees", title=f"{file.name}: {found.status.value}")
    for name, aim in _cameras(file, found).items():
        sees = [target for target, quality in found.targets.items() if name in quality.seen_by]
        cameras.add_row(name, _aim_in_words(aim), ", ".join(sees) or "[yellow]nothing[/yellow]")
    targets = Table("target", f"quality, {unit}", "seen by")
    for name, quality in found.targets.items():
        value = "[red]not covered[/red]" if quality.quality_m is None else f"{quality.quality_m * 1e3:.3f}"
        targets.add_row(name, value, ", ".join(quality.seen_by))
    results.print(cameras, targets)
    summary = "nothing covered"
    if found.objective_m is not None:
        summary = f"{settings.objective} {found.objective_m * 1e3:.4f} {unit}"
    covered = f"{len(found.targets) - len(found.uncovered)} of {len(found.targets)} targets covered"
    results.print(f"{summary}, {covered}, {found.solve_s * 1e3:.0f} ms")


_WORDS = {"pan_deg": "pan {:.2f} deg", "tilt_deg": "tilt {:.2f} deg", "yaw_deg": "yaw {:.2f} deg", "zoom": "zoom {:g}"}


def _aim_in_words(aim: Mapping[str, object]) -> str:
    words = [text.format(aim[key]) for key, text in _WORDS.items() if key in aim]
    match aim:
        case {"position_m": [x, y, z]}:
            words.insert(0, f"at {x:.3f}, {y:.3f}, {z:.3f} m")
    return ", ".join(words)
