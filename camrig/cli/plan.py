"""``camrig plan``: plans scenes off line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_args

import typer
from rich.table import Table

from camrig import optimise
from camrig.cli.console import print_json, progress_bar, results
from camrig.clock import RealClock
from camrig.config.scene import SceneFile, load_scene
from camrig.errors import ConfigError, Fault, InputError, PartialError
from camrig.messages import Aim, HeadAim, RigPlan
from camrig.optimise.scene import FixedPlace, Objective, Quality, Visibility
from camrig.report.plan_map import write_plan_map

Solver = Literal["descent"]
ChoiceT = TypeVar("ChoiceT", bound=str)


def plan(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="The scenes' YAML files.")],
    quality: Annotated[str | None, typer.Option(help="Quality model: pixel (the paper's).")] = None,
    visibility: Annotated[str | None, typer.Option(help="cone (the paper's) or image (the true picture).")] = None,
    objective: Annotated[str | None, typer.Option(help="mean over the covered targets.")] = None,
    solver: Annotated[str, typer.Option(help="descent: block-coordinate descent and polish.")] = "descent",
    deadline_s: Annotated[float | None, typer.Option(help="Seconds a scene may take; the best so far counts.")] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed gives the same plan.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Write a map of the (single) plan to this PNG.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a scene.")] = False,
) -> None:
    """Find where every camera of a scene should look or hover. Exit code 4 where a target stays uncovered."""
    _choice("--solver", solver, get_args(Solver), solver)
    if deadline_s is not None and not deadline_s > 0.0:
        raise InputError(f"--deadline-s must be above 0, not {deadline_s:g}")
    if picture is not None and len(scenes) > 1:
        raise InputError("--picture draws one scene; give a single SCENE with it")
    files = [_override(file, quality, visibility, objective, deadline_s, seed) for file in _load(scenes)]
    plans, failures = _plan_all(files, as_json)
    if picture is not None and plans:
        write_plan_map(picture, files[0].scene, plans[0])
    if failures:
        raise (PartialError if plans else InputError)("\n".join(failures))
    if any(found.uncovered for found in plans):
        raise typer.Exit(PartialError.exit_code)


def _load(paths: Sequence[Path]) -> list[SceneFile]:
    """Read all scenes before any is planned; raises ConfigError with the faults of all files."""
    files: list[SceneFile] = []
    faults: list[Fault] = []
    for path in paths:
        try:
            files.append(load_scene(path))
        except ConfigError as error:
            faults += error.faults
    if faults:
        raise ConfigError(faults)
    return files


def _override(
    file: SceneFile,
    quality: str | None,
    visibility: str | None,
    objective: str | None,
    deadline_s: float | None,
    seed: int | None,
) -> SceneFile:
    """Put the command line's flags over the file's ``planner`` section."""
    given = file.scene.settings
    settings = replace(
        given,
        quality=_choice("--quality", quality, get_args(Quality), given.quality),
        visibility=_choice("--visibility", visibility, get_args(Visibility), given.visibility),
        objective=_choice("--objective", objective, get_args(Objective), given.objective),
    )
    return replace(
        file,
        scene=replace(file.scene, settings=settings),
        deadline_s=file.deadline_s if deadline_s is None else deadline_s,
        seed=file.seed if seed is None else seed,
    )


def _choice(option: str, value: str | None, allowed: Sequence[ChoiceT], default: ChoiceT) -> ChoiceT:
    if value is None:
        return default
    for choice in allowed:
        if value == choice:
            return choice
    raise InputError(f"{option} takes {' or '.join(allowed)}, not '{value}'")


def _plan_all(files: Sequence[SceneFile], as_json: bool) -> tuple[list[RigPlan], list[str]]:
    """Plan and show every scene; returns the plans, and a message for each scene that could not be planned."""
    clock = RealClock()
    plans: list[RigPlan] = []
    failures: list[str] = []
    with progress_bar("planning", len(files), hidden=as_json) as progress:
        for file in files:
            try:
                found = optimise.plan(file.scene, deadline_s=file.deadline_s, seed=file.seed, now=clock.now_s)
            except InputError as error:
                failures.append(f"{file.file}: {error}")
                if as_json:
                    print_json({"scene": file.name, "file": file.file, "error": str(error)})
            else:
                plans.append(found)
                if as_json:
                    print_json(_as_json(file, found))
                else:
                    _print_tables(file, found)
            progress.advance(progress.task_ids[0])
    return plans, failures


def _as_json(file: SceneFile, found: RigPlan) -> dict[str, object]:
    return {
        "scene": file.name,
        "file": file.file,
        "status": found.status.value,
        "objective_m": found.objective_m,
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
            aims[camera.id] = _aim_as_json(found.aims[camera.id])
    return aims


def _aim_as_json(aim: Aim) -> dict[str, object]:
    if isinstance(aim, HeadAim):
        return {"pan_deg": math.degrees(aim.pan_rad), "tilt_deg": math.degrees(aim.tilt_rad)}
    return {"position_m": list(aim.position_m), "yaw_deg": math.degrees(aim.yaw_rad)}


def _print_tables(file: SceneFile, found: RigPlan) -> None:
    cameras = Table("camera", "aim", "sees", title=f"{file.name}: {found.status.value}")
    for name, aim in _cameras(file, found).items():
        sees = [target for target, quality in found.targets.items() if name in quality.seen_by]
        cameras.add_row(name, _aim_in_words(aim), ", ".join(sees) or "[yellow]nothing[/yellow]")
    targets = Table("target", "quality", "seen by")
    for name, quality in found.targets.items():
        value = "[red]not covered[/red]" if quality.quality_m is None else f"{quality.quality_m * 1e3:.3f} mm/px"
        targets.add_row(name, value, ", ".join(quality.seen_by))
    results.print(cameras, targets)
    mean = "nothing covered" if found.objective_m is None else f"mean {found.objective_m * 1e3:.4f} mm/px"
    covered = len(found.targets) - len(found.uncovered)
    results.print(f"{mean}, {covered} of {len(found.targets)} targets covered, {found.solve_s * 1e3:.0f} ms")


def _aim_in_words(aim: dict[str, object]) -> str:
    match aim:
        case {"pan_deg": float(pan_deg), "tilt_deg": float(tilt_deg)}:
            return f"pan {pan_deg:.2f}, tilt {tilt_deg:.2f} deg"
        case {"position_m": [float(x), float(y), float(z)]}:
            return f"at {x:.3f}, {y:.3f}, {z:.3f} m"
        case _:
            return ""
