"""The rig from above in a terminal: floor, fields of view, targets and where they truly are, and a table beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from camrig.geometry.arrays import Array
from camrig.geometry.frustum import footprint
from camrig.messages import CameraPose, LinkStatus, RigPlan, Target, TargetStatus
from camrig.rig import Rig

COLUMNS, ROWS = 64, 32
"""The map's largest size; a floor that is deeper than wide fills the rows."""
ASPECT = 0.5
"""A terminal's character is about twice as high as it is wide."""
SHADES = " .:-=+"


@dataclass(frozen=True)
class RigSnapshot:
    """What one picture of the rig shows; ``truth`` is (3,) metres by target, known only for an emulated world."""

    rig: Rig
    targets: tuple[Target, ...]
    truth: Mapping[str, Array]
    camera_poses: Mapping[str, CameraPose]
    links: Mapping[str, LinkStatus]
    plan: RigPlan | None
    status: str


def rig_view(snapshot: RigSnapshot, title: str) -> RenderableType:
    """Return the map and its tables, for rich to draw."""
    tables = Group(_targets(snapshot), _links(snapshot))
    return Panel(Columns([floor_map(snapshot), tables]), title=title, subtitle=snapshot.status)


def floor_map(snapshot: RigSnapshot) -> Text:
    """Return the floor from above, north up; the shade says how many cameras see a place."""
    canvas = _Canvas(snapshot.rig)
    for name, pose in snapshot.camera_poses.items():
        canvas.shade(footprint(snapshot.rig.cameras[name].lens, pose.T_world_camera))
    for anchor in snapshot.rig.anchors:
        canvas.mark(anchor.T_world_tag[:3, 3], "#", "yellow")
    for name, pose in snapshot.camera_poses.items():
        canvas.mark(pose.T_world_camera[:3, 3], name[0].upper(), "bold magenta")
    for position in snapshot.truth.values():
        canvas.mark(position, "o", "white")
    for number, target in enumerate(snapshot.targets, 1):
        if target.status is not TargetStatus.UNSEEN:
            style = "bold green" if target.status is TargetStatus.TRACKED else "bold red"
            canvas.mark(target.position_m, str(number % 10), style)
    return canvas.text()


class _Canvas:
    """A grid of characters over the rig's floor."""

    def __init__(self, rig: Rig) -> None:
        self._low, self._high = np.array(rig.space.floor_m)
        width, depth = self._high - self._low
        rows_per_column = ASPECT * float(depth / width)
        self._columns = max(2, min(COLUMNS, round(ROWS / rows_per_column)))
        self._rows = max(8, min(ROWS, round(COLUMNS * rows_per_column)))
        self._seen = np.zeros((self._rows, self._columns), np.uint8)
        self._marks: dict[tuple[int, int], tuple[str, str]] = {}

    def shade(self, polygon_m: Array) -> None:
        """Count one camera more over a floor polygon (n, 2)."""
        if len(polygon_m) >= 3:
            mask = np.zeros_like(self._seen)
            cv2.fillPoly(mask, [np.round(self._cell(polygon_m)).astype(np.int32)], 1)
            self._seen += mask

    def mark(self, point_m: Array, letter: str, style: str) -> None:
        """Write a letter at a place; the last one written there stays."""
        x, y = np.round(self._cell(point_m)).astype(int)
        self._marks[int(y), int(x)] = (letter, style)

    def text(self) -> Text:
        """Return the drawn map."""
        text = Text(no_wrap=True, overflow="crop")
        for y in range(self._rows):
            for x in range(self._columns):
                shade = SHADES[min(int(self._seen[y, x]), len(SHADES) - 1)]
                text.append(*self._marks.get((y, x), (shade, "blue")))
            text.append("\n")
        return text

    def _cell(self, points_m: Array) -> Array:
        place = (np.asarray(points_m)[..., :2] - self._low) / (self._high - self._low)
        return np.stack([place[..., 0] * self._columns - 0.5, (1.0 - place[..., 1]) * self._rows - 0.5], axis=-1)


def _targets(snapshot: RigSnapshot) -> Table:
    table = Table("#", "target", "seen by", "sigma mm", "error mm", title="Targets")
    for number, target in enumerate(snapshot.targets, 1):
        if target.status is not TargetStatus.TRACKED:
            table.add_row(str(number), target.id, f"[red]{target.status.value}[/red]", "", "")
            continue
        sigma_mm = 1000.0 * float(np.sqrt(np.trace(target.covariance_m2)))
        truth = snapshot.truth.get(target.id)
        error = "" if truth is None else f"{1000.0 * float(np.linalg.norm(target.position_m - truth)):.1f}"
        table.add_row(str(number), target.id, " ".join(target.seen_by), f"{sigma_mm:.1f}", error)
    return table


def _links(snapshot: RigSnapshot) -> Table:
    table = Table("link", "state", title="Links")
    for name, status in sorted(snapshot.links.items()):
        colour = {LinkStatus.UP: "green", LinkStatus.LOST: "red"}.get(status, "yellow")
        table.add_row(name, f"[{colour}]{status.value}[/{colour}]")
    return table
