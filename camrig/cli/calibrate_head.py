"""``camrig calibrate head``: what one pan-tilt head is really like."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from camrig.calibrate.head_model import AxisModel, HeadModel
from camrig.calibrate.head_result import HeadResult
from camrig.cli.agreed import agreed
from camrig.cli.asked_files import check_files, collected, write_report
from camrig.cli.calibrate_head_answer import as_json, page, print_result
from camrig.cli.console import people, print_json, progress_bar
from camrig.cli.lending import lent
from camrig.cli.refinement import load_refinement
from camrig.cli.signals import INTERRUPTED, asked_to_stop
from camrig.clock import Clock, RealClock
from camrig.config.amend import amend_rig, check_amendable
from camrig.config.head_changes import head_changes, head_places
from camrig.config.rig_file import RigConfig, load_rig
from camrig.errors import InputError, PartialError
from camrig.rig import CameraSpec, HeadMount, Interval
from camrig.runtime.emulated import emulated_world
from camrig.runtime.head_bench import HeadBench, Interrupted
from camrig.runtime.head_blind import MOST_RAD, BlindBench, run_blind_calibration
from camrig.runtime.head_calibration import camera_eye, plain_head, reads_back, run_calibration
from camrig.runtime.head_survey import Place, Tell

_LIMITS = "LOW HIGH"
_MOST_DEG = math.degrees(MOST_RAD)


@dataclass(frozen=True)
class TagSizes(Mapping[str, float]):
    """Sizes of tags that stand still: those of the file, and one for all that it does not list."""

    listed: Mapping[str, float]
    moving: frozenset[str]
    other_m: float | None

    def __getitem__(self, name: str) -> float:
        size_m = self.listed.get(name, None if name in self.moving else self.other_m)
        if size_m is None:
            raise KeyError(name)
        return size_m

    def __iter__(self) -> Iterator[str]:
        return iter(self.listed)

    def __len__(self) -> int:
        return len(self.listed)


def head(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
    name: Annotated[
        str, typer.Argument(metavar="HEAD", help="The head's id; its camera looks at tags that stand still.")
    ],
    pan_deg: Annotated[
        tuple[float, float] | None, typer.Option(metavar=_LIMITS, help="Narrower than the file's limits.")
    ] = None,
    tilt_deg: Annotated[
        tuple[float, float] | None, typer.Option(metavar=_LIMITS, help="Narrower than the file's limits.")
    ] = None,
    tag_size_m: Annotated[
        float | None,
        typer.Option(min=0.005, max=5.0, help="Side of the black square of fixed tags that the file does not list."),
    ] = None,
    free_tags: Annotated[
        bool, typer.Option("--free-tags", help="Take no anchor's place for known: only sizes are.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Move without asking: nobody is in the way, cables are long enough.")
    ] = False,
    write: Annotated[
        bool, typer.Option("--write", help="Write what was found into the file; the former one is kept beside it.")
    ] = False,
    report: Annotated[Path | None, typer.Option(metavar="FILE.html", help="Write a page with figures.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find a head's axes, camera, counting, play, dead time and speeds by moving it for three minutes.

    It stays within the limits, begins with a small turn, and stops on Ctrl-C and on anything odd. The tags may hang
    anywhere as long as they stand still; anchors in view place the head in the world too. A daemon that runs the rig
    lends the head and its camera, and works on with the others.
    """
    rig_config = load_rig(config)
    camera = _camera_of(rig_config, name)
    place = _place(rig_config, name, camera, (pan_deg, tilt_deg), tag_size_m, free_tags=free_tags)
    check_files({"--report": report}, config)
    if write:
        check_amendable(config, head_places(rig_config, name, camera.id))
    blind = not reads_back(rig_config, name)
    if blind and (pan_deg is not None or tilt_deg is not None):
        raise InputError(
            f"{name} tells no angles, so --pan-deg and --tilt-deg cannot be kept: it is turned {_MOST_DEG:g} deg to "
            "either side of where it stands; leave them out"
        )
    agreed([_motion(name, place, blind=blind)], [name], yes=yes)
    if rig_config.refine:
        load_refinement()
    with emulated_world(rig_config) as (running, world), ExitStack() as borrowed:
        clock = RealClock()
        taken_back = threading.Event()
        if world is None:
            taken_back = borrowed.enter_context(lent(rig_config.rig.name, name, clock))
        result = _calibrated(running, name, camera, place, clock, taken_back, hidden=json)
    _hand_out(rig_config, config, name, camera, result, write=write, report=report, json=json)


def _calibrated(
    running: RigConfig,
    name: str,
    camera: CameraSpec,
    place: Place,
    clock: Clock,
    taken_back: threading.Event,
    *,
    hidden: bool,
) -> HeadResult:
    """Run the calibration; Ctrl-C ends it, and so does a daemon that has ``taken_back`` what it lent."""
    with asked_to_stop() as asked, camera_eye(running, camera.id, clock) as eye, _progress(hidden=hidden) as tell:
        plain = plain_head(running, name)

        def asked_to_end() -> bool:
            return asked.is_set() or taken_back.is_set()

        try:
            if reads_back(running, name):
                bench = HeadBench(name, plain, eye, clock, place.sizes_m, asked_to_end)
                return run_calibration(bench, place, tell, partial(plain_head, running, name))
            blind = BlindBench(name, plain, eye, clock, place.sizes_m, asked_to_end)
            return run_blind_calibration(blind, place, tell)
        except Interrupted:
            why = "the daemon has taken it back, as `camrig hold` has it do: " if taken_back.is_set() else ""
            people.print(f"{why}{name} is stopped; nothing was written", highlight=False, markup=False)
            raise typer.Exit(INTERRUPTED) from None


def _hand_out(
    rig_config: RigConfig,
    config: Path,
    name: str,
    camera: CameraSpec,
    result: HeadResult,
    *,
    write: bool,
    report: Path | None,
    json: bool,
) -> None:
    changes = head_changes(rig_config, name, camera.id, result)
    bad = result.verdict == "red"
    faults: list[str] = []  # three minutes of motion are not lost by a file
    if write and not bad:
        with collected(faults):
            amend_rig(config, changes)
    written = write and not bad and not faults
    if json:
        print_json(as_json(name, camera.id, result, changes, str(config) if written else None))
    else:
        print_result(name, result, changes, written=written)
    if report is not None:
        with collected(faults):
            write_report(report, page(name, config, result, changes))
            people.print(f"the report is {report}", highlight=False, markup=False, soft_wrap=True)
    if bad:
        unfit = f"{name} is not fit for use as it is, and nothing was written: {result.reasons()[0][1]}"
        faults.insert(0, unfit)
    if faults:
        raise PartialError("\n".join(faults))


def _camera_of(config: RigConfig, name: str) -> CameraSpec:
    heads = config.rig.heads
    if name not in heads:
        raise InputError(f"rig '{config.rig.name}' has no head '{name}'; it has {', '.join(heads) or 'none'}")
    camera = config.rig.camera_on(name)
    assert camera is not None, "a rig's file is refused where a head carries none"
    return camera


def _place(
    config: RigConfig,
    name: str,
    camera: CameraSpec,
    narrower_deg: tuple[tuple[float, float] | None, tuple[float, float] | None],
    tag_size_m: float | None,
    *,
    free_tags: bool,
) -> Place:
    """Return what is known beforehand. Raises InputError where no tag has a size."""
    rig = config.rig
    spec = rig.heads[name]
    assert isinstance(camera.mount, HeadMount)
    listed = {str(anchor.key): anchor.size_m for anchor in rig.anchors}
    listed |= {
        str(tag.key): tag.size_m for body in rig.targets.values() if body.motion == "static" for tag in body.tags
    }
    moving = {str(tag.key) for body in rig.targets.values() if body.motion != "static" for tag in body.tags}
    if not listed and tag_size_m is None:
        raise InputError(
            f"{config.file} lists no tag that stands still: name anchors or static targets, or give --tag-size-m"
        )
    kinematics = spec.kinematics
    return Place(
        lens=camera.lens,
        sizes_m=TagSizes(listed, frozenset(moving), tag_size_m),
        file=HeadModel(
            kinematics.T_world_base, kinematics.T_arm_tilt, camera.mount.T_mount_camera, (AxisModel(), AxisModel())
        ),
        limits_rad=(
            _narrowed("pan", spec.pan_limits_rad, narrower_deg[0]),
            _narrowed("tilt", spec.tilt_limits_rad, narrower_deg[1]),
        ),
        speed_rad_s=spec.speed_rad_s,
        anchors={} if free_tags else {str(anchor.key): anchor.T_world_tag for anchor in rig.anchors},
    )


def _narrowed(axis: str, limits_rad: Interval, narrower_deg: tuple[float, float] | None) -> Interval:
    if narrower_deg is None:
        return limits_rad
    low, high = (math.radians(value) for value in narrower_deg)
    if not limits_rad[0] - 1e-9 <= low < high <= limits_rad[1] + 1e-9:
        allowed = " to ".join(f"{math.degrees(limit):g}" for limit in limits_rad)
        raise InputError(
            f"--{axis}-deg {narrower_deg[0]:g} {narrower_deg[1]:g}: give the lower first, within the file's {allowed}"
        )
    return low, high


def _motion(name: str, place: Place, *, blind: bool) -> str:
    """Say what will move, and how far."""
    if blind:
        return (
            f"{name} tells no angles: it will be turned for a minute, {_MOST_DEG:g} deg to either side of where it "
            "stands, pan limits or not, at up to its full speed."
        )
    pan, tilt = ("{:.0f} to {:.0f}".format(*map(math.degrees, limits)) for limits in place.limits_rad)
    return f"{name} will move for three minutes, pan {pan} deg and tilt {tilt} deg at most, at up to its full speed."


@contextmanager
def _progress(*, hidden: bool) -> Iterator[Tell]:
    with progress_bar("opening", 1.0, hidden=hidden) as progress:

        def tell(what: str, share: float) -> None:
            progress.update(progress.task_ids[0], description=what, completed=share)

        yield tell
