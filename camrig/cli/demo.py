"""``camrig demo``: the whole rig on emulated hardware, optimised and then held still, scored against the truth."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from typing import Annotated, Any

import numpy as np
import typer
from rich.live import Live
from rich.table import Table

from camrig.cli.console import people, print_json, progress_bar, results
from camrig.cli.kernels import load_daemons_kernels, load_kernels
from camrig.cli.run import log_to_stderr, stopped_by_signals
from camrig.config.rig_file import RigConfig, load_rig
from camrig.config.settings import settings_of
from camrig.errors import HardwareError
from camrig.interfaces import Published, World
from camrig.messages import FlightState, TargetStatus
from camrig.report.score import ErrorStatistics, Samples, ScoreSink, coverage, errors_on_common
from camrig.report.terminal_map import RigSnapshot, rig_view
from camrig.rig import Rig
from camrig.runtime.daemon import Daemon
from camrig.runtime.emulated import emulated_world

READY_TIMEOUT_S = 90.0
WARM_UP_S = 12.0
"""How long before the scored span the held run's world starts: links, take-off, filters."""
REFRESH_S = 0.2


@dataclass
class PlanTimes:
    """Collects how long each plan took to solve."""

    solve_s: dict[int, float]

    def open(self, rig: Rig) -> None:
        """Need nothing of the rig."""

    def write(self, published: Published) -> None:
        if published.plan is not None:
            self.solve_s[published.plan.request_id] = published.plan.solve_s

    def close(self) -> None:
        """Keep the times."""


@dataclass(frozen=True)
class Phase:
    """What one run of the demo gave, over its scored span of the world's time."""

    samples: Samples
    from_s: float
    tracked: int
    fps: dict[str, float]
    plan_s: tuple[float, ...]


def demo(
    headless: Annotated[
        bool, typer.Option("--headless", help="No live map; run, score, and print the result.")
    ] = False,
    seconds: Annotated[float, typer.Option(min=1.0, max=3600.0, help="Length of each scored run.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Seed of the emulated world.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Run three heads and a drone on emulated hardware: scan, track, aim; then the same with every aim held."""
    log_to_stderr(logging.WARNING)
    with as_file(files("camrig.config") / "examples" / "demo.yaml") as path:
        config = load_rig(path)
    load_kernels(settings_of(config).planner)
    load_daemons_kernels()
    show = not headless
    optimised = _run_phase(config, seed, seconds, start_s=0.0, aim=True, show=show)
    start_s = max(0.0, optimised.from_s - WARM_UP_S)
    held = _run_phase(config, seed, seconds, start_s=start_s, aim=False, show=show, score_from_s=optimised.from_s)
    answer = _answer(config, optimised, held, seconds, seed)
    if as_json:
        print_json(answer)
    else:
        results.print(_result_table(answer))


def _run_phase(
    config: RigConfig,
    seed: int,
    seconds: float,
    *,
    start_s: float,
    aim: bool,
    show: bool,
    score_from_s: float | None = None,
) -> Phase:
    assert config.world is not None  # the demo's own file
    section = config.world.section.model_copy(update={"seed": seed, "start_s": start_s})
    config = replace(config, world=replace(config.world, section=section))
    name = "optimised" if aim else "held"
    with ExitStack() as stack:
        started, world = stack.enter_context(emulated_world(config))
        assert world is not None
        score, plan_times = ScoreSink(world), PlanTimes({})
        settings = settings_of(started, aim=aim)
        daemon = Daemon(started, settings, extra_sinks=[score, plan_times])
        stack.enter_context(stopped_by_signals(daemon))
        stack.callback(daemon.stop)
        daemon.start()
        _wait_until_ready(daemon, world, name, score_from_s, show)
        from_s = score_from_s if score_from_s is not None else world.elapsed_s(daemon.clock.now_s())
        frames = {camera: job.frames for camera, job in daemon.devices.cameras.items()}
        began_s = daemon.clock.now_s()
        _watch(daemon, world, name, from_s + seconds, show)
        lasted_s = daemon.clock.now_s() - began_s
        fps = {camera: (job.frames - frames[camera]) / lasted_s for camera, job in daemon.devices.cameras.items()}
        tracked = _tracked(daemon)
    return Phase(score.between(from_s, from_s + seconds), from_s, tracked, fps, tuple(plan_times.solve_s.values()))


def _wait_until_ready(daemon: Daemon, world: World, name: str, score_from_s: float | None, show: bool) -> None:
    """Arm the emulated drones; then wait for the end of the scan, or for the span that is to be scored."""
    deadline_s = daemon.clock.now_s() + READY_TIMEOUT_S
    armed: set[str] = set()
    with _live(show) as live:
        while not _ready(daemon, world, score_from_s):
            _turn(daemon, world, live, f"{name}: getting ready")
            for drone, flight in daemon.control.state.flight.items():
                # The demo is the operator of its own emulated drones.
                if flight is FlightState.GROUND and drone not in armed and _fit(daemon, drone):
                    daemon.arm(drone)
                    armed.add(drone)
            if daemon.clock.now_s() > deadline_s:
                waited = f"{READY_TIMEOUT_S:.0f} s"
                raise HardwareError(f"the emulated rig was not ready within {waited}: {daemon.status_line()}")


def _fit(daemon: Daemon, drone: str) -> bool:
    """Tell whether a drone has told all that must be known before it may be armed, and may be."""
    health = daemon.devices.drones[drone].health
    return health is None or not health.unfit


def _ready(daemon: Daemon, world: World, score_from_s: float | None) -> bool:
    if score_from_s is not None:
        return world.elapsed_s(daemon.clock.now_s()) >= score_from_s
    state = daemon.control.state
    flying = all(state.flight.get(drone) is FlightState.FLYING for drone in daemon.config.rig.drones)
    return flying and not state.mission.scanning and _tracked(daemon) == len(daemon.config.rig.targets)


def _watch(daemon: Daemon, world: World, name: str, until_s: float, show: bool) -> None:
    """Let the rig work until the world's time ``until_s``."""
    began_s = world.elapsed_s(daemon.clock.now_s())
    with _live(show) as live, progress_bar(f"{name} run", until_s - began_s, hidden=show) as progress:
        while (elapsed_s := world.elapsed_s(daemon.clock.now_s())) < until_s:
            progress.update(progress.task_ids[0], completed=elapsed_s - began_s)
            _turn(daemon, world, live, f"{name}: {elapsed_s - began_s:.0f} of {until_s - began_s:.0f} s")


def _turn(daemon: Daemon, world: World, live: Live | None, title: str) -> None:
    daemon.supervise(daemon.clock.now_s() + REFRESH_S)
    if daemon.stop_requested:
        raise KeyboardInterrupt
    if live is not None:
        live.update(rig_view(snapshot(daemon, world), title))


def snapshot(daemon: Daemon, world: World) -> RigSnapshot:
    """Return what the live map shows now."""
    published = daemon.control.latest
    stamp_s = published.stamp_s if published else daemon.clock.now_s()
    return RigSnapshot(
        rig=daemon.config.rig,
        targets=published.targets if published else (),
        truth={name: T[:3, 3] for name, T in world.truth(stamp_s).items()},
        camera_poses=dict(daemon.control.state.camera_poses),
        links=dict(daemon.control.link_states),
        plan=daemon.control.state.mission.plan,
        status=daemon.status_line(),
    )


def _live(show: bool) -> AbstractContextManager[Live | None]:
    return Live(console=people, transient=True, refresh_per_second=1.0 / REFRESH_S) if show else nullcontext()


def _tracked(daemon: Daemon) -> int:
    published = daemon.control.latest
    return sum(target.status is TargetStatus.TRACKED for target in published.targets) if published else 0


def _answer(config: RigConfig, optimised: Phase, held: Phase, seconds: float, seed: int) -> dict[str, object]:
    """Return the demo's result as docs of ``camrig demo --json`` have it."""
    better, worse = (
        errors_on_common(optimised.samples, held.samples),
        errors_on_common(held.samples, optimised.samples),
    )
    return {
        "seconds": seconds,
        "cameras": len(config.rig.cameras),
        "targets": len(config.rig.targets),
        "tracked": optimised.tracked,
        "fps": round(sum(optimised.fps.values()), 1),
        "fps_by_camera": {name: round(fps, 1) for name, fps in optimised.fps.items()},
        "error_mm": {"optimised": _in_mm(better), "held": _in_mm(worse)},
        "coverage": {"optimised": round(coverage(optimised.samples), 4), "held": round(coverage(held.samples), 4)},
        "plan_ms": {
            "median": round(1000.0 * float(np.median(optimised.plan_s)), 1),
            "p95": round(1000.0 * float(np.percentile(optimised.plan_s, 95)), 1),
            "n": len(optimised.plan_s),
        },
        "scan_s": round(optimised.from_s, 1),
        "seed": seed,
    }


def _in_mm(errors: ErrorStatistics) -> dict[str, float | int]:
    return {"mean": round(1000.0 * errors.mean_m, 2), "p95": round(1000.0 * errors.p95_m, 2), "n": errors.n}


def _result_table(answer: Mapping[str, Any]) -> Table:
    table = Table("", "optimised", "held", title=f"camrig demo, seed {answer['seed']}, {answer['seconds']:g} s each")
    errors, covered = answer["error_mm"], answer["coverage"]
    for row, key in (("mean error (mm)", "mean"), ("95th percentile (mm)", "p95")):
        table.add_row(row, f"{errors['optimised'][key]:.1f}", f"{errors['held'][key]:.1f}")
    table.add_row("coverage", f"{covered['optimised']:.1%}", f"{covered['held']:.1%}")
    table.caption = f"{answer['fps']} frames/s from {answer['cameras']} cameras; errors on the samples both published"
    return table
