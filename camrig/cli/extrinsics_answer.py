"""What ``camrig calibrate extrinsics`` says: a table, JSON, a verdict with its reasons, the sections of a report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from rich.table import Column, Table

from camrig.calibrate.extrinsics import Extrinsics, Uncertain
from camrig.calibrate.judge import missing_links
from camrig.calibrate.scale import Scaled
from camrig.calibrate.setup import Setup
from camrig.cli.console import COLOURS, people, results
from camrig.cli.extrinsics_warnings import warnings_of
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, look_of
from camrig.geometry.pose import difference, transform
from camrig.geometry.rotation import rpy_of
from camrig.messages import Verdict
from camrig.report.calibration import CalibrationReport
from camrig.rig import FixedMount, HeadMount, Rig

USELESS_PX = 3.0
"""Corners that miss by more than this, one sigma, say nothing."""

STRAIGHT_RAD = 0.02
"""Within this of straight down people are told a camera's turn as pan."""


COLUMNS = ("camera", "position m", "± mm", "pan, tilt, roll deg", "± deg", "file off by")


@dataclass(frozen=True, slots=True)
class Placed:
    """A camera (of one on a head, the head's base) as people read it: place, one sigma of it, how it looks or, of a
    base, stands, and how far that is from the file's own word, None where there is none.
    """

    position_m: list[float]
    sigma_mm: list[float]
    sigma_deg: float
    pan_deg: float
    tilt_deg: float
    roll_deg: float
    off_file_mm: float | None
    off_file_deg: float | None


@dataclass(frozen=True)
class Answer:
    """Everything that was found, and what was noticed before (``noticed``); ``asked`` are the cameras with pictures."""

    rig: Rig
    scaled: Scaled
    noticed: tuple[str, ...]
    asked: tuple[str, ...]

    @property
    def setup(self) -> Setup:
        return self.scaled.setup

    @property
    def found(self) -> Extrinsics:
        return self.scaled.found

    @property
    def in_world(self) -> bool:
        """Whether something says where the world is."""
        return self.found.anchored or bool(self.setup.kept)

    @property
    def is_usable(self) -> bool:
        """Whether what was placed can be used at all."""
        return self.found.noise_px <= USELESS_PX

    @cached_property
    def missing(self) -> list[tuple[str, str]]:
        """Which camera that hangs on nothing should see something together with which other."""
        places_m = {name: T[:3, 3] for name in self.asked if (T := self._of_file(name)) is not None}
        return missing_links(self.asked, self.found.shared, places_m)

    @cached_property
    def placeless(self) -> tuple[str, ...]:
        """The placed cameras of which the file can say no place: on heads, by pictures that say no aim, or in hands."""
        return tuple(name for name in self.found.cameras if not isinstance(self.rig.cameras[name].mount, FixedMount))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What is amiss, and what to do."""
        placeless = (
            f"{name} is not fixed, and its pictures do not say where its head pointed: its place is not for the file"
            for name in self.placeless
        )
        return (*self.noticed, *warnings_of(self.scaled, in_world=self.in_world), *placeless)

    def lost(self) -> Iterator[str]:
        """Yield a sentence for each camera that was not placed."""
        for name in self.asked:
            if name in self.found.unplaced:
                link = next((pair for pair in self.missing if name in pair), None)
                other = next((each for each in link or () if each != name), None)
                cure = f": carry the board where {name} and {other} see it at once, or let both see one tag" * bool(
                    other
                )
                yield f"{name} shares no tag with the others: hangs on nothing{cure}"

    def verdict(self) -> tuple[Verdict, list[str]]:
        """Return green, amber or red, and why."""
        lost = list(self.lost())
        if lost or not self.is_usable:
            return Verdict.RED, [*lost, *self.warnings]
        if self.warnings:
            return Verdict.AMBER, list(self.warnings)
        worst = max((float(np.max(each.sigma_mm)) for each in self.found.placed_cameras.values()), default=0.0)
        return Verdict.GREEN, [
            f"corners miss by {self.found.median_px:.2f} px; every camera is known to {worst:.1f} mm"
        ]

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield the table's cells: what was found of each camera, or its head's base."""
        for name in self.found.placed_cameras:
            each = self.placed(name)
            yield (
                f"{name}, its head's base" if name in self.found.bases else name,
                ", ".join(f"{value:.4f}" for value in each.position_m),
                ", ".join(f"{value:.2f}" for value in each.sigma_mm),
                f"{each.pan_deg:.2f}, {each.tilt_deg:.2f}, {each.roll_deg:.2f}",
                f"{each.sigma_deg:.3f}",
                "" if each.off_file_mm is None else f"{each.off_file_mm:.1f} mm, {each.off_file_deg:.2f} deg",
            )

    def placed(self, name: str) -> Placed:
        """Describe a camera, or its head's base."""
        pose, before = self.found.placed_cameras[name], self._of_file(name)
        # A base looks along its x where a camera looks along its z.
        R = pose.T[:3, :3] @ (R_MOUNT_OPTICAL if name in self.found.bases else np.eye(3))
        pan, tilt, roll = (round(math.degrees(angle), 4) for angle in look_of(R, STRAIGHT_RAD))
        off = difference(pose.T, before) if before is not None and self.in_world else None
        return Placed(
            position_m=np.round(pose.T[:3, 3], 5).tolist(),
            sigma_mm=np.round(pose.sigma_mm, 3).tolist(),
            sigma_deg=round(pose.sigma_deg, 5),
            pan_deg=pan,
            tilt_deg=tilt,
            roll_deg=roll,
            off_file_mm=None if off is None else round(1e3 * float(np.linalg.norm(off[:3])), 2),
            off_file_deg=None if off is None else round(math.degrees(np.linalg.norm(off[3:])), 3),
        )

    def print(self) -> None:
        """Print the table, and what was noticed."""
        first = next(iter(self.found.placed_cameras))
        world = "Cameras in the world" if self.in_world else f"Cameras as {first} sees them: nothing says where that is"
        table = Table(Column(COLUMNS[0], no_wrap=True), *COLUMNS[1:], title=world)
        for row in self.rows():
            table.add_row(*row)
        results.print(table)
        for line in self.facts():
            results.print(line, highlight=False, markup=False)
        verdict, _ = self.verdict()
        results.print(f"verdict: {verdict}", highlight=False, style=COLOURS[verdict])
        for warning in self.warnings:
            people.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)

    def as_json(self) -> dict[str, object]:
        """Return the last line of ``--json``."""
        found = self.found
        verdict, reasons = self.verdict()
        return {
            "rms_px": round(found.rms_px, 4),
            "median_px": round(found.median_px, 4),
            "noise_px": round(found.noise_px, 4),
            "anchored": found.anchored,
            "verdict": str(verdict),
            "reasons": reasons,
            "cameras": {
                name: {"T_world_camera": pose.T.tolist(), **asdict(self.placed(name))}
                for name, pose in found.cameras.items()
            },
            "heads": {self._head_of(name): self._head_json(name) for name in found.bases},
            "tags": {
                **{name: _mark_json("T_world_tag", mark) for name, mark in found.room.items()},
                **{
                    name: {**_mark_json("T_board_tag", mark), "board": found.body_of[name]}
                    for name, mark in found.body_marks.items()
                },
            },
            "links": [{"cameras": list(pair), "shared": count} for pair, count in found.shared.items() if count],
            "missing_links": [list(pair) for pair in self.missing],
            "unplaced": list(found.unplaced),
            "tag_size_factor": self.scaled.factor,
            "lengths": [
                {"tags": [each.length.a, each.length.b], "given_m": each.length.metres, "found_m": each.found_m}
                for each in self.scaled.misfits
            ],
            "warnings": list(self.warnings),
        }

    def report(self, command: str) -> CalibrationReport:
        """Return the page of HTML."""
        from camrig.cli.extrinsics_report import page  # noqa: PLC0415 - draws, which takes its time to load

        return page(self, command)

    def facts(self) -> Iterator[str]:
        """Yield what the table does not say."""
        found = self.found
        instants = len({instant for _, instant in found.T_world_body})
        carried = f", {instants} instants" if instants else ""
        yield (
            f"{len(found.sighted)} marks in pictures{carried}; corners miss by {found.median_px:.2f} px "
            f"(median; rms {found.rms_px:.2f})"
        )
        if found.room:
            yield f"in the room: {', '.join(found.room)}"
        for name, off in found.aims_off_deg.items():
            worst = float(np.abs(off).max(initial=0.0))
            yield f"{name}: its head says its angles to {worst:.2f} deg at {len(off)} aims"
        if self.scaled.factor is not None:
            yield f"tags are {self.scaled.factor:.4f} times as large as was said, by the measured length"
        for each in self.scaled.misfits:
            length = each.length
            yield f"{length.a} to {length.b}: {each.found_m:.4f} m, measured {length.metres:.4f} m"

    def _of_file(self, name: str) -> Transform | None:
        """Return where the file has a camera, or its head."""
        mount = self.rig.cameras[name].mount
        if isinstance(mount, FixedMount):
            return mount.T_world_camera
        if isinstance(mount, HeadMount) and name in self.setup.heads:
            return self.rig.heads[mount.head].kinematics.T_world_base
        return None

    def _head_of(self, name: str) -> str:
        mount = self.rig.cameras[name].mount
        assert isinstance(mount, HeadMount)
        return mount.head

    def _head_json(self, name: str) -> Mapping[str, object]:
        base = self.found.bases[name]
        mount = self.found.mounts.get(name)
        each = self.placed(name)
        return {
            "camera": name,
            "T_world_head": base.T.tolist(),
            "position_m": each.position_m,
            "rpy_deg": rpy_deg(base.T[:3, :3]),
            "sigma_mm": each.sigma_mm,
            "sigma_deg": each.sigma_deg,
            "off_file_mm": each.off_file_mm,
            "off_file_deg": each.off_file_deg,
            "T_mount_camera": None if mount is None else mount.T.tolist(),
            "aims_off_deg": np.round(self.found.aims_off_deg[name], 4).tolist(),
        }


def rpy_deg(R: Array) -> list[float]:
    """Return roll, pitch and yaw as the file has them."""
    return [round(math.degrees(angle), 4) for angle in rpy_of(R)]


def without_optical(T_mount_camera: Transform) -> Transform:
    """Return a mount-to-camera transform as the file has it: of a camera that looks along the mount's x none."""
    return np.asarray(T_mount_camera @ transform(R_MOUNT_OPTICAL.T, np.zeros(3)))


def _mark_json(name: str, mark: Uncertain) -> dict[str, object]:
    return {name: mark.T.tolist(), "sigma_mm": np.round(mark.sigma_mm, 3).tolist()}
