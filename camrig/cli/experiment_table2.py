"""``camrig experiment table2``: one rig aimed by several methods, emulated or real, through the running daemon."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from importlib import metadata
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.choice import choices
from camrig.cli.console import note, people, progress_bar
from camrig.cli.experiment_common import Out, folder_of, hand_out
from camrig.cli.kernels import load_daemons_kernels, load_kernels
from camrig.cli.run import log_to_stderr, stopped_by_signals
from camrig.config.rig_file import RigConfig, load_rig
from camrig.config.settings import settings_of
from camrig.errors import InputError
from camrig.experiments import machine
from camrig.experiments.kept import Kept
from camrig.experiments.surveyed import load_surveyed
from camrig.experiments.table2 import METHODS, Method, Score, Truth, play
from camrig.experiments.table2_report import Report, as_json, as_markdown
from camrig.geometry.arrays import Array
from camrig.optimise.comparators.ipopt import load_casadi
from camrig.runtime.daemon import Daemon
from camrig.runtime.emulated import emulated_world


def table2(
    scenes: Annotated[int, typer.Option(min=1, help="Arrangements of the robots; one on a real rig.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene; the next one's is one more.")] = 1,
    methods: Annotated[str | None, typer.Option(help=f"Some of {','.join(METHODS)}; all where not given.")] = None,
    rig: Annotated[
        Path | None, typer.Option(help="Run it on this rig instead of the emulated one; its heads are moved.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="With --rig: where its targets stand, CSV of id,x_m,y_m,z_m in the world.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="With --rig: move its heads without being asked again.")] = False,
    quick: Annotated[bool, typer.Option(help="One scene: does it work at all?")] = False,
    out: Out = None,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object, with every target.")] = False,
) -> None:
    """Make the paper's second table again: manual aim, Arslan's, the paper's and camrig's, on one rig."""
    log_to_stderr(logging.ERROR)
    asked = _methods(methods)
    surveyed, config = _surveyed(rig, truth)
    if rig is not None:
        _confirm(config, yes)
    count = 1 if quick or rig is not None else scenes
    kept = Kept(_file(folder_of(out), rig), f"table2 of camrig {metadata.version('camrig')}")
    scores = _scores(config, surveyed, range(seed, seed + count), asked, kept, hidden=as_json_object)
    report = Report(
        _name(config, rig, count),
        _command(asked, rig, truth, count, seed),
        machine.machine(),
        machine.versions(),
        scores,
    )
    hand_out("table2", out, as_markdown(report), as_json(report), as_json=as_json_object)


def _methods(given: str | None) -> tuple[Method, ...]:
    if given is not None:
        return choices("--methods", given, METHODS)
    try:
        load_casadi()
    except InputError as error:
        note(f"without paper-ipopt: {error}")
        return tuple(method for method in METHODS if method != "paper-ipopt")
    return METHODS


def _surveyed(rig: Path | None, truth: Path | None) -> tuple[Mapping[str, Array] | None, RigConfig]:
    """Return where a real rig's targets stand, None for an emulated one, and the rig."""
    if (rig is None) != (truth is None):
        raise InputError("--rig and --truth go together: a real rig is scored against where its targets truly stand")
    if rig is None or truth is None:
        with as_file(files("camrig.experiments") / "table2.yaml") as path:
            return None, load_rig(path)
    config = load_rig(rig)
    if not config.rig.heads:
        raise InputError(f"{rig}: the table compares ways to aim heads, and this rig has none")
    return load_surveyed(truth, config.rig.targets), config


def _confirm(config: RigConfig, yes: bool) -> None:
    """Raise InputError unless somebody says that heads may move."""
    heads = ", ".join(config.rig.heads)
    if not yes and not (people.is_terminal and typer.confirm(f"This moves the heads {heads}. Is everybody clear?")):
        raise InputError(f"nothing was moved: --yes says that the heads {heads} may be")


def _file(folder: Path | None, rig: Path | None) -> Path | None:
    """Return where scenes are kept; a real rig's are not, for it may have been changed."""
    return None if folder is None or rig is not None else folder / "table2.jsonl"


def _scores(
    config: RigConfig,
    surveyed: Mapping[str, Array] | None,
    seeds: range,
    methods: tuple[Method, ...],
    kept: Kept,
    *,
    hidden: bool,
) -> list[Score]:
    load_kernels(settings_of(config).planner)
    load_daemons_kernels()
    scores = []
    with progress_bar("aiming", len(seeds) * len(methods), hidden=hidden) as progress:
        for seed in seeds:
            key = f"{seed} {','.join(methods)}"
            if key not in kept:
                played = []
                with _running(config, seed, surveyed) as (daemon, truth):
                    for score in play(daemon, truth, seed, methods):
                        played.append(asdict(score))
                        progress.advance(progress.task_ids[0])
                kept.add(key, played)
            else:
                progress.advance(progress.task_ids[0], len(methods))
            scores += [Score(**score) for score in kept[key]]
    return scores


@contextmanager
def _running(config: RigConfig, seed: int, surveyed: Mapping[str, Array] | None) -> Iterator[tuple[Daemon, Truth]]:
    """Run the rig while inside: in an emulated world of a seed, or the real one with its heads allowed to move."""
    if surveyed is None and config.world is not None:
        section = config.world.section.model_copy(update={"seed": seed})
        config = replace(config, world=replace(config.world, section=section))
    with ExitStack() as stack:
        started, world = stack.enter_context(emulated_world(config))
        daemon = Daemon(started, settings_of(started))
        stack.enter_context(stopped_by_signals(daemon))
        stack.callback(daemon.stop)
        daemon.start()
        daemon.resume(tuple(config.rig.heads))

        def truth(stamp_s: float) -> Mapping[str, Array]:
            if surveyed is not None or world is None:
                return surveyed or {}
            return {name: T[:3, 3] for name, T in world.truth(stamp_s).items()}

        yield daemon, truth


def _name(config: RigConfig, rig: Path | None, count: int) -> str:
    if rig is not None:
        return f"The rig {config.rig.name}, surveyed"
    heads, targets, anchors = len(config.rig.heads), len(config.rig.targets), len(config.rig.anchors)
    return (
        f"{count} scenes of the emulated rig: {heads} ceiling heads over Pelco-D with play, rounded read-back and zero "
        f"errors, {targets} robots and {anchors} anchors on a floor of 5 m x 3 m"
    )


def _command(methods: tuple[Method, ...], rig: Path | None, truth: Path | None, count: int, seed: int) -> str:
    words = f"--methods {','.join(methods)}"
    where = f"--rig {rig} --truth {truth}" if rig is not None else f"--scenes {count} --seed {seed}"
    return f"{machine.THREADS}=1 camrig experiment table2 {where} {words}"
