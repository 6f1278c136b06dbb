"""``camrig calibrate body``: where the tags of a target are on it, from pictures of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Column, Table

from camrig.calibrate.body import Layout, layout
from camrig.calibrate.judge import loose_marks
from camrig.cli.asked_files import check_files, collected, write_report
from camrig.cli.calibration_pictures import Asked, blaming, places_of, read_shots
from camrig.cli.console import note, people, print_json, results
from camrig.cli.extrinsics_answer import rpy_deg
from camrig.cli.extrinsics_changes import in_words, metres, pose_of, tell_unwritten, today
from camrig.config.amend import amend_rig, check_amendable
from camrig.config.document import KeyPath
from camrig.config.rig_file import load_rig
from camrig.errors import InputError, PartialError
from camrig.geometry.arrays import Array
from camrig.geometry.pose import difference
from camrig.messages import Verdict
from camrig.report.calibration import CalibrationReport, Drawing
from camrig.report.calibration import Table as PageTable
from camrig.rig import Body, Rig

FEW_PICTURES = 5
"""A tag that was seen together with another one less often is tied loosely."""

NOISY_PX, USELESS_PX = 1.0, 3.0
"""Corners that miss by more, one sigma, are not those of a stiff body and a right lens, or say nothing."""

UNSURE_MM, UNSURE_DEG = 5.0, 1.0
"""A tag known no better than this says little about where its body is."""


@dataclass(frozen=True, slots=True)
class PlacedTag:
    """A tag as people read it; ``off_file`` is how far it is from where the file has it."""

    position_m: list[float]
    rpy_deg: list[float]
    sigma_mm: list[float]
    sigma_deg: float
    off_file_mm: float | None
    off_file_deg: float | None
    pictures: int


def body(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file: lenses, and the target with its tags' sizes.")],
    target: Annotated[str, typer.Argument(help="The target's id.")],
    from_images: Annotated[
        list[str],
        typer.Option(metavar="CAMERA=PICTURES", help="Pictures of it by a camera of the rig: folder, glob or video."),
    ],
    frame: Annotated[
        str | None, typer.Option(metavar="TAG", help="The tag that stays where the file has it; else the first.")
    ] = None,
    add: Annotated[bool, typer.Option("--add", help="Take tags that the file does not list for the target's.")] = False,
    tag_size_m: Annotated[float | None, typer.Option(help="With --add: side of their black square.")] = None,
    write: Annotated[bool, typer.Option("--write", help="Write the result into the rig's file.")] = False,
    report: Annotated[Path | None, typer.Option(metavar="HTML", help="Write a page with figures.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find where tags are on a robot: turn it before a camera, or walk around it, so that tags are seen two and two.

    One camera suffices; where it is does not matter, and either may move between pictures. The tag that the target's
    frame hangs on stays as the file has it, all others are found. Exit code 4 where a tag or a picture could not be
    used, or the result is of no use. Nothing is written without `--write`.
    """
    rig_config = load_rig(config)
    rig = rig_config.rig
    if target not in rig.targets:
        raise InputError(f"rig '{rig.name}' has no target '{target}'; it has {', '.join(rig.targets) or 'none'}")
    of = rig.targets[target]
    check_files({"--report": report}, config)
    if write:
        check_amendable(config, _places(of, add=add))
    places = places_of(from_images, rig)
    shots, faults = read_shots(rig_config, Asked(places), hidden=as_json)
    sizes_m = _sizes_m(rig, of, {tag for shot in shots for tag in shot.corners_px}, add=add, tag_size_m=tag_size_m)
    others = sorted({tag for shot in shots for tag in shot.corners_px} - sizes_m.keys() - _elsewhere(rig, of))
    shots = [replace(s, corners_px={tag: px for tag, px in s.corners_px.items() if tag in sizes_m}) for s in shots]
    held = frame or str(of.tags[0].key)
    listed = {str(tag.key): tag.T_body_tag for tag in of.tags}
    if held not in listed:
        raise InputError(f"--frame {held}: target '{target}' has no such tag; it has {', '.join(listed)}")
    lenses = {name: rig.cameras[name].lens for name in places}
    with blaming(faults), people.status("placing tags"):
        answer = _Answer(of, layout(shots, lenses, sizes_m, (held, listed[held])), held, tuple(others))
    if as_json:
        print_json({**answer.as_json(), "changes": in_words(answer.changes())})
    else:
        answer.print()
    bad = [f"{tag} is never in a picture with another placed tag: show both at once" for tag in answer.unplaced]
    if not answer.is_usable:
        bad.append(f"this is not fit for use{', nothing was written' if write else ''}: see the warnings")
    elif write:
        with collected(bad):
            amend_rig(config, answer.changes())
            note(f"{config} has the new places of {target}'s tags; the former file is beside it")
    elif not as_json:
        tell_unwritten(answer.changes())
    if report is not None:
        with collected(bad):
            write_report(report, answer.report(f"camrig calibrate body {config} {target}, {today()}"))
    if faults or bad:
        raise PartialError("\n".join([*bad, *faults]))


def _places(of: Body, *, add: bool) -> list[KeyPath]:
    """Return where --write may write, before it is known what."""
    tags: list[KeyPath] = [("targets", of.id, "tags", k, "T_body_tag") for k in range(len(of.tags))]
    added: list[KeyPath] = [("targets", of.id, "tags", len(of.tags))] if add else []
    return [("targets", of.id, "calibrated"), *tags, *added]


def _sizes_m(rig: Rig, of: Body, seen: set[str], *, add: bool, tag_size_m: float | None) -> dict[str, float]:
    """Return the sizes of the target's tags, with those that are added."""
    own = {str(tag.key): tag.size_m for tag in of.tags}
    if not add:
        return own
    if tag_size_m is None or not 0.0 < tag_size_m <= 5.0:
        raise InputError("--add: give the size of the tags that the file does not list, --tag-size-m, up to 5 m")
    return own | dict.fromkeys(sorted(seen - own.keys() - _elsewhere(rig, of)), tag_size_m)


def _elsewhere(rig: Rig, of: Body) -> set[str]:
    """Return the tags that belong to something else."""
    others = (tag.key for body in rig.targets.values() if body.id != of.id for tag in body.tags)
    return {str(key) for key in (*others, *(anchor.key for anchor in rig.anchors))}


@dataclass(frozen=True)
class _Answer:
    """What was found of a target; ``unlisted`` are tags that were seen and that nobody said anything of."""

    body: Body
    layout: Layout
    held: str
    unlisted: tuple[str, ...]

    @property
    def is_usable(self) -> bool:
        """Whether what was placed can be used at all."""
        return self.layout.found.noise_px <= USELESS_PX

    @cached_property
    def unplaced(self) -> tuple[str, ...]:
        """The target's tags that were not placed."""
        placed = self.layout.found.body_marks
        return tuple(tag for tag in self.layout.together if tag not in placed)

    @cached_property
    def tags(self) -> Mapping[str, PlacedTag]:
        listed = {str(tag.key): tag.T_body_tag for tag in self.body.tags}
        return {
            name: self._placed(name, None if name not in listed else difference(mark.T, listed[name]))
            for name, mark in self.layout.found.body_marks.items()
        }

    def _placed(self, name: str, off: Array | None) -> PlacedTag:
        mark = self.layout.found.body_marks[name]
        return PlacedTag(
            position_m=metres(mark.T),
            rpy_deg=rpy_deg(mark.T[:3, :3]),
            sigma_mm=np.round(mark.sigma_mm, 3).tolist(),
            sigma_deg=round(mark.sigma_deg, 4),
            off_file_mm=None if off is None else round(1e3 * float(np.linalg.norm(off[:3])), 2),
            off_file_deg=None if off is None else round(float(np.degrees(np.linalg.norm(off[3:]))), 3),
            pictures=self.layout.together[name],
        )

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What is amiss, and what to do."""
        return tuple(self._warnings())

    def _warnings(self) -> Iterator[str]:
        found = self.layout.found
        if found.noise_px > NOISY_PX:
            yield f"corners miss by {found.noise_px:.1f} px: the body bends, or a lens or a tag's size is wrong"
        for loose in loose_marks(found):
            share = f"{100.0 * loose.share:.0f} % of its corners are elsewhere"
            yield f"{loose.mark} does not keep its place on {self.body.id}: {share}; is it on something else?"
        for name, tag in self.tags.items():
            if tag.pictures < FEW_PICTURES:
                yield f"{name} is in only {tag.pictures} pictures with another tag: take more that show both"
            elif name != self.held and (max(tag.sigma_mm) > UNSURE_MM or tag.sigma_deg > UNSURE_DEG):
                known = f"{name} is known to {max(tag.sigma_mm):.1f} mm and {tag.sigma_deg:.2f} deg only"
                yield f"{known}: take pictures from nearer, and from other sides"
        if self.unlisted:
            yield f"{', '.join(self.unlisted)}: seen, and not listed in the file; with --add they are {self.body.id}'s"

    def verdict(self) -> tuple[Verdict, list[str]]:
        """Return green, amber or red, and why."""
        if self.unplaced or not self.is_usable:
            lost = [f"{tag} is not placed" for tag in self.unplaced]
            return Verdict.RED, [*lost, *self.warnings]
        if self.warnings:
            return Verdict.AMBER, list(self.warnings)
        worst_mm = max((max(tag.sigma_mm) for tag in self.tags.values()), default=0.0)
        return Verdict.GREEN, [f"corners miss by {self.layout.found.median_px:.2f} px; tags known to {worst_mm:.1f} mm"]

    def rows(self) -> list[tuple[str, ...]]:
        """Return the table's cells."""
        return [
            (
                f"{name} (held)" if name == self.held else name,
                ", ".join(f"{value:.4f}" for value in tag.position_m),
                ", ".join(f"{value:.2f}" for value in tag.rpy_deg),
                ", ".join(f"{value:.2f}" for value in tag.sigma_mm),
                f"{tag.sigma_deg:.3f}",
                str(tag.pictures),
                "" if tag.off_file_mm is None else f"{tag.off_file_mm:.1f} mm, {tag.off_file_deg:.2f} deg",
            )
            for name, tag in self.tags.items()
        ]

    def print(self) -> None:
        """Print the table, and what is amiss."""
        table = Table(Column(COLUMNS[0], no_wrap=True), *COLUMNS[1:], title=f"Tags of {self.body.id}")
        for row in self.rows():
            table.add_row(*row)
        results.print(table)
        verdict, _ = self.verdict()
        found = self.layout.found
        results.print(f"corners miss by {found.median_px:.2f} px (median; rms {found.rms_px:.2f}); verdict: {verdict}")
        for warning in self.warnings:
            people.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)

    def as_json(self) -> dict[str, object]:
        """Return the last line of ``--json``."""
        found = self.layout.found
        verdict, reasons = self.verdict()
        return {
            "target": self.body.id,
            "rms_px": round(found.rms_px, 4),
            "median_px": round(found.median_px, 4),
            "noise_px": round(found.noise_px, 4),
            "verdict": str(verdict),
            "reasons": reasons,
            "frame": self.held,
            "tags": {
                name: {"T_body_tag": found.body_marks[name].T.tolist(), **asdict(tag)}
                for name, tag in self.tags.items()
            },
            "unplaced": list(self.unplaced),
            "warnings": list(self.warnings),
        }

    def changes(self) -> dict[KeyPath, object]:
        """Return what is written into the file."""
        listed = {str(tag.key): k for k, tag in enumerate(self.body.tags)}
        changes: dict[KeyPath, object] = {("targets", self.body.id, "calibrated"): today()}
        at = len(listed)
        sizes_m = {each.mark: float(each.points_m[1, 0] - each.points_m[0, 0]) for each in self.layout.found.sighted}
        for name, mark in self.layout.found.body_marks.items():
            if name == self.held:
                continue
            if name in listed:
                changes["targets", self.body.id, "tags", listed[name], "T_body_tag"] = pose_of(mark.T)
                continue
            family, _, number = name.rpartition(":")
            tag = {"family": family, "id": int(number), "size_m": round(sizes_m[name], 5)}
            changes["targets", self.body.id, "tags", at] = {**tag, "T_body_tag": pose_of(mark.T)}
            at += 1
        return changes

    def report(self, command: str) -> CalibrationReport:
        """Return the page of HTML."""
        from camrig.report.extrinsics_figures import BodyPicture  # noqa: PLC0415 - draws

        verdict, reasons = self.verdict()
        found = self.layout.found
        facts = {
            "target": self.body.id,
            "pictures": str(len({each.picture for each in found.sighted})),
            "frame": self.held,
            "one sigma of corners": f"{found.noise_px:.3f} px",
        }
        sizes_m = {each.mark: float(each.points_m[1, 0] - each.points_m[0, 0]) for each in found.sighted}
        picture = BodyPicture({name: (mark.T, sizes_m[name]) for name, mark in found.body_marks.items()})
        sections = (
            PageTable("Tags", COLUMNS, self.rows()),
            Drawing("The body", picture.draw, (8.0, 4.0), "Its tags from above, from the front, from the side; in mm."),
        )
        return CalibrationReport(f"Where the tags of {self.body.id} are", verdict, reasons, facts, sections, command)


COLUMNS: Sequence[str] = ("tag", "position m", "roll, pitch, yaw deg", "± mm", "± deg", "pictures", "file off by")
