"""``camrig calibrate check``: how well a rig's calibration fits what its cameras see now."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Column, Table

from camrig.calibrate.fit_now import FitNow, Off, fit_now, stations
from camrig.calibrate.setup import OnHead, Setup
from camrig.calibrate.sighted import ROOM, Shot
from camrig.calibrate.stillness import stillness
from camrig.cli.asked_files import check_files, collected, write_report
from camrig.cli.calibration_pictures import Asked, blaming, listed_sizes_m, places_of, read_shots
from camrig.cli.console import COLOURS, print_json, results
from camrig.cli.extrinsics_changes import today
from camrig.cli.rig_shots import rig_shots
from camrig.config.rig_file import load_rig
from camrig.errors import HardwareError, InputError, PartialError
from camrig.geometry.arrays import Array, Transform
from camrig.messages import Verdict, worst
from camrig.report.calibration import CalibrationReport
from camrig.report.calibration import Table as PageTable
from camrig.rig import FixedMount, HeadMount, Rig

AMBER_PX, RED_PX = 1.5, 5.0
"""Corners that miss by more, in the middle."""

AMBER_MM, RED_MM = 10.0, 40.0
"""A camera that is elsewhere by more, as anchors have it, and by more than ``SURE`` sigmas."""

AMBER_DEG, RED_DEG = 0.25, 1.0
"""One that looks elsewhere by more."""

SURE = 4.0
OLD_DAYS = 180
"""A calibration that nobody made again for so long is worth another look."""


@dataclass(frozen=True, slots=True)
class CameraFit:
    """How one camera fits; None where nothing tells. ``off`` is at the worst of a head's stops."""

    verdict: Verdict
    reasons: list[str]
    anchors: int
    anchor_px: float | None
    anchor_mm: float | None
    off_mm: float | None
    off_deg: float | None
    sigma_mm: float | None
    sigma_deg: float | None
    shared: int
    shared_px: float | None
    shared_mm: float | None
    calibrated: str | None
    age_days: int | None


def check(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
    from_images: Annotated[
        list[str] | None,
        typer.Option(metavar="CAMERA=PICTURES", help="Pictures instead of the rig's cameras: folder, glob or video."),
    ] = None,
    stamps: Annotated[
        Path | None, typer.Option(metavar="CSV", help="When pictures were taken: columns camera, stamp_s, in order.")
    ] = None,
    report: Annotated[Path | None, typer.Option(metavar="HTML", help="Write a page.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare where cameras see anchors, and what several cameras see, with where the file has the cameras.

    Without `--from-images` it opens the rig's cameras and reads its heads' angles; nothing moves. A tag that moves is
    compared in pictures of one instant only. Green: nothing to do. Amber: worth a look, the reasons say why. Red, exit
    code 4: calibrate again.
    """
    rig_config = load_rig(config)
    rig = rig_config.rig
    check_files({"--report": report}, config, stamps)
    if from_images:
        shots, faults = read_shots(rig_config, Asked(places_of(from_images, rig), {}, stamps), hidden=as_json)
    else:
        shots, faults = rig_shots(rig_config, hidden=as_json)
        if faults and not shots:
            raise HardwareError("\n".join(faults))
    with blaming(faults):
        answer = _Answer(rig, _fits(rig, shots, at_once=bool(from_images)), today())
    if as_json:
        print_json(answer.as_json())
    else:
        answer.print()
    unwritten: list[str] = []
    if report is not None:
        with collected(unwritten):
            write_report(report, answer.report(f"camrig calibrate check {config}, {today()}"))
    red = [name for name, each in answer.cameras.items() if each.verdict is Verdict.RED]
    words = [f"the calibration does not fit: {', '.join(red)}"] if red else []
    if red or faults or unwritten:
        raise PartialError("\n".join([*words, *unwritten, *faults]))


def _fits(rig: Rig, shots: Sequence[Shot], *, at_once: bool) -> tuple[FitNow, Setup]:
    """Compare all that can be compared: of what moves only what cameras saw ``at_once``.

    Raises InputError where that is nothing.
    """
    sizes_m = listed_sizes_m(rig)
    anchors = {str(anchor.key): anchor.T_world_tag for anchor in rig.anchors}
    told = stillness(shots, frozenset(anchors))
    used = sizes_m.keys() - (set() if at_once else told.carried)
    shots = [replace(s, corners_px={tag: px for tag, px in s.corners_px.items() if tag in used}) for s in shots]
    bases: dict[str, Transform] = {}
    heads: dict[str, OnHead] = {}
    aimed = {shot.camera_id for shot in shots if shot.aim_rad is not None}
    for name in dict.fromkeys(shot.camera_id for shot in shots):
        match rig.cameras[name].mount:
            case FixedMount(T_world_camera=T):
                bases[name] = T
            case HeadMount(head=head, T_mount_camera=T_mount_camera) if name in aimed:
                axes, sigma_rad = rig.heads[head].kinematics, rig.heads[head].bias_sigma_rad
                bases[name] = axes.T_world_base
                heads[name] = OnHead(axes.T_arm_tilt, T_mount_camera, sigma_rad)
    if not bases:
        raise InputError("no picture is of a camera whose place is known: fixed, or on a head that said its angles")
    still = told.still - anchors.keys()
    lenses = {name: rig.cameras[name].lens for name in bases}
    setup = Setup(lenses, sizes_m, anchors, dict.fromkeys(still, ROOM), heads)
    return fit_now(shots, setup, stations(shots, setup, bases)), setup


class _Answer:
    """What is said of each camera, and of all."""

    def __init__(self, rig: Rig, fits: tuple[FitNow, Setup], now: date) -> None:
        fit, setup = fits
        self._rig = rig
        self.cameras: Mapping[str, CameraFit] = {
            name: _camera(rig, name, fit, setup, now) for name in rig.cameras if name in setup.lenses
        }
        self.unseen = tuple(name for name in rig.cameras if name not in setup.lenses)

    @property
    def verdict(self) -> Verdict:
        """Return the worst of all cameras'."""
        return worst(each.verdict for each in self.cameras.values())

    def reasons(self) -> list[str]:
        """Return all reasons, by camera."""
        return [f"{name}: {reason}" for name, each in self.cameras.items() for reason in each.reasons] or ["all fits"]

    def rows(self) -> list[tuple[str, ...]]:
        """Return the table's cells."""
        return [
            (
                name,
                str(each.verdict),
                str(each.anchors),
                _two(each.anchor_px, each.anchor_mm, "px", "mm"),
                _two(each.off_mm, each.off_deg, "mm", "deg"),
                _two(each.sigma_mm, each.sigma_deg, "mm", "deg"),
                _two(each.shared_px, each.shared_mm, "px", "mm"),
                "" if each.age_days is None else f"{each.age_days} days",
            )
            for name, each in self.cameras.items()
        ]

    def print(self) -> None:
        """Print the table and the reasons."""
        table = Table(
            Column(COLUMNS[0], no_wrap=True), *COLUMNS[1:], title=f"How the calibration of {self._rig.name} fits now"
        )
        for row, each in zip(self.rows(), self.cameras.values(), strict=True):
            table.add_row(*row, style=COLOURS[each.verdict])
        results.print(table)
        for reason in self.reasons():
            results.print(reason, highlight=False, markup=False, soft_wrap=True)
        for name in self.unseen:
            results.print(f"{name}: not looked at", highlight=False, markup=False)

    def as_json(self) -> dict[str, object]:
        """Return the last line of ``--json``."""
        return {
            "verdict": str(self.verdict),
            "reasons": self.reasons(),
            "cameras": {name: asdict(each) for name, each in self.cameras.items()},
            "not_checked": list(self.unseen),
        }

    def report(self, command: str) -> CalibrationReport:
        """Return the page of HTML."""
        facts = {"rig": self._rig.name, "not looked at": ", ".join(self.unseen) or "none"}
        sections = (PageTable("Cameras", COLUMNS, self.rows(), NOTE),)
        return CalibrationReport(
            f"How the calibration of {self._rig.name} fits", self.verdict, self.reasons(), facts, sections, command
        )


COLUMNS = ("camera", "verdict", "anchors", "they miss by", "camera off by", "± (1 sigma)", "shared tags miss by", "age")
NOTE = "Misses are medians of corners; 'off by' is where anchors have the camera, at the worst of a head's stops."


def _camera(rig: Rig, name: str, fit: FitNow, setup: Setup, now: date) -> CameraFit:
    offs = [off for (camera, _), off in fit.by_anchors.items() if camera == name]
    shared_px, shared_mm = fit.agreement.of_camera(name)
    farthest = max(offs, key=lambda off: off.off_mm / AMBER_MM + off.off_deg / AMBER_DEG, default=None)
    when = rig.cameras[name].calibrated
    bias_deg = math.degrees(setup.heads[name].angle_sigma_rad) if name in setup.heads else 0.0
    allowed = _Allowed(bias_deg, SURE * math.radians(bias_deg) * float(np.mean(setup.lenses[name].focal_px)))
    age_days = None if when is None else (now - when).days
    reasons = list(_reasons(farthest, shared_px, fit.seen[name], allowed, age_days))
    verdict = worst(verdict for verdict, _ in reasons)
    miss_px, miss_mm = (np.concatenate([getattr(off, part) for off in offs] or [[]]) for part in ("miss_px", "miss_mm"))
    return CameraFit(
        verdict=verdict,
        reasons=[reason for _, reason in reasons],
        anchors=len({anchor for off in offs for anchor in off.anchors}),
        anchor_px=_median(miss_px),
        anchor_mm=_median(miss_mm),
        off_mm=None if farthest is None else round(farthest.off_mm, 2),
        off_deg=None if farthest is None else round(farthest.off_deg, 4),
        sigma_mm=None if farthest is None else round(farthest.sigma_mm, 2),
        sigma_deg=None if farthest is None else round(farthest.sigma_deg, 4),
        shared=len(shared_px),
        shared_px=_median(shared_px),
        shared_mm=_median(shared_mm),
        calibrated=None if when is None else when.isoformat(),
        age_days=age_days,
    )


@dataclass(frozen=True, slots=True)
class _Allowed:
    """What a head may be off: one sigma of its angles, and what that comes to in pixels."""

    bias_deg: float
    px: float


def _reasons(
    farthest: Off | None, shared_px: Array, seen: int, allowed: _Allowed, age_days: int | None
) -> Iterator[tuple[Verdict, str]]:
    """Yield what speaks against a camera's calibration, and what it is worth."""
    if farthest is not None:
        yield from _against(farthest, allowed)
    if len(shared_px):
        miss_px = float(np.median(shared_px))
        if miss_px > AMBER_PX + allowed.px:
            verdict = Verdict.RED if miss_px > RED_PX + allowed.px else Verdict.AMBER
            yield verdict, f"does not agree with other cameras: corners that several see miss by {miss_px:.1f} px"
    if farthest is None and not len(shared_px):
        what = "no anchor, and no tag that another camera sees" if seen else "no tag of the file"
        yield Verdict.AMBER, f"sees {what}: nothing tells how it fits"
    if age_days is not None and age_days > OLD_DAYS:
        yield Verdict.AMBER, f"was calibrated {age_days} days ago"


def _against(off: Off, allowed: _Allowed) -> Iterator[tuple[Verdict, str]]:
    miss_px = float(np.median(off.miss_px))
    sure_mm, sure_deg = off.off_mm > SURE * off.sigma_mm, off.off_deg > SURE * max(off.sigma_deg, allowed.bias_deg)
    red = (sure_mm and off.off_mm > RED_MM) or (sure_deg and off.off_deg > RED_DEG)
    if red or (sure_mm and off.off_mm > AMBER_MM) or (sure_deg and off.off_deg > AMBER_DEG):
        where = f"anchors have it {off.off_mm:.0f} mm (± {off.sigma_mm:.0f}) and {off.off_deg:.2f} deg elsewhere"
        yield Verdict.RED if red else Verdict.AMBER, f"{where}: camrig calibrate extrinsics"
    elif miss_px > AMBER_PX + allowed.px:
        verdict = Verdict.RED if miss_px > RED_PX + allowed.px else Verdict.AMBER
        yield verdict, f"anchors miss by {miss_px:.1f} px, wherever it is: was one moved, or is the lens wrong?"


def _median(values: Array) -> float | None:
    return round(float(np.median(values)), 3) if len(values) else None


def _two(a: float | None, b: float | None, unit_a: str, unit_b: str) -> str:
    return "" if a is None or b is None else f"{a:.2f} {unit_a}, {b:.2f} {unit_b}"
