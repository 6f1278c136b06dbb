"""One plan drawn into matplotlib axes: the quality map underneath, then boxes, footprints, cameras and targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon, Rectangle
from matplotlib.path import Path
from matplotlib.patheffects import withStroke

from camrig.geometry.arrays import Array
from camrig.geometry.frustum import cone_directions, rays_footprint, rim_directions
from camrig.messages import RigPlan
from camrig.optimise import DronePlace, FixedPlace, HeadPlace, Scene, View, quality_map, views
from camrig.optimise.scene import Place

RED, NOWHERE = "#d40000", "#e4e4e4"
BOX: dict[str, Any] = {"facecolor": "#b8b8b8", "edgecolor": "#444444", "hatch": "////", "linewidth": 0.8}
SYMBOLS: dict[type[Place], tuple[str, str]] = {
    HeadPlace: ("^", "camera on a head"),
    DronePlace: ("D", "camera on a drone"),
    FixedPlace: ("s", "fixed camera"),
}
COLOURS = ("#0057a3", "#b23c00", "#00704f", "#a3297a", "#3b3b3b", "#7a5200", "#5b2da3")
_DASHES = ("-", "--", ":")
_TARGET_PT = 13.0
CROWD = 80
"""More targets than this are dots without words."""
_COLUMNS = 320
"""Places of the quality map along the longer side of the room."""
_WORST_SHOWN = 95.0
"""Percentile of the map that its colours reach: far corners would take them all."""
_WIDE = 8.0
"""From this ratio of worst to best on, colours go by ratios instead of differences."""
_BORDER, _LEAST_BORDER_M = 0.06, 0.3
_CASING = [withStroke(linewidth=3.0, foreground="white")]


@dataclass(frozen=True)
class Extent:
    """What of the world is drawn: lowest and highest (2,) corner, and the height of the plane of the targets."""

    low: Array
    high: Array
    height_m: float

    @property
    def width_m(self) -> float:
        """Extent along x."""
        return float(self.high[0] - self.low[0])

    @property
    def depth_m(self) -> float:
        """Extent along y."""
        return float(self.high[1] - self.low[1])


@dataclass(frozen=True)
class Word:
    """A label, its place in the world, and its colour."""

    text: str
    at: tuple[float, float]
    colour: str
    is_target: bool = False


@dataclass
class Words:
    """The labels of a plan, and the (2,) places that they must not cover."""

    labels: list[Word] = field(default_factory=list)
    marks: list[tuple[float, float]] = field(default_factory=list)

    def without_targets(self) -> Words:
        """Return only the names of cameras, and of targets that nobody sees."""
        return replace(self, labels=[word for word in self.labels if not word.is_target or word.colour == RED])


def extent_of(scene: Scene, plan: RigPlan) -> Extent:
    """Return what a picture of the plan shows."""
    points = [tuple(view.T_world_camera[:2, 3]) for view in views(scene, plan)]
    points += [target.position_m[:2] for target in scene.targets]
    points += [anchor.position_m[:2] for anchor in scene.anchors]
    points += [corner[:2] for box in scene.keep_out_m for corner in box]
    for camera in scene.cameras:
        match camera.place:
            case DronePlace(box_m=box) | HeadPlace(mount_m=(_, _) as box):
                points += [corner[:2] for corner in box]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    border = max(_LEAST_BORDER_M, _BORDER * float((high - low).max()))
    height_m = float(np.median([target.position_m[2] for target in scene.targets]))
    return Extent(low - border, high + border, height_m)


def draw_plan(axes: Axes, scene: Scene, plan: RigPlan, extent: Extent) -> tuple[AxesImage | None, Words]:
    """Draw everything but the labels; returns the quality map, if any place is seen, and the labels to be placed."""
    axes.set(xlim=(extent.low[0], extent.high[0]), ylim=(extent.low[1], extent.high[1]), aspect="equal")
    axes.set(xlabel="x, m", ylabel="y, m", facecolor=NOWHERE)
    painted = _paint_quality(axes, scene, plan, extent)
    for low, high in scene.keep_out_m:
        axes.add_patch(Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1], zorder=1.5, **BOX))
    words = Words()
    colours = {camera.id: COLOURS[i % len(COLOURS)] for i, camera in enumerate(scene.cameras)}
    for number, (camera, view) in enumerate(zip(scene.cameras, views(scene, plan), strict=True)):
        colour = colours[camera.id]
        _draw_limits(axes, camera.place, colour)
        _draw_footprint(axes, scene, view, extent, colour, _DASHES[number // len(COLOURS) % len(_DASHES)])
        _draw_camera(axes, camera.place, view, extent, colour, words)
    for anchor in scene.anchors:
        axes.plot(*anchor.position_m[:2], "P", color="black", markeredgecolor="white", markersize=8, zorder=4)
        words.marks.append(anchor.position_m[:2])
    _draw_targets(axes, scene, plan, colours, words)
    return painted, words


def _paint_quality(axes: Axes, scene: Scene, plan: RigPlan, extent: Extent) -> AxesImage | None:
    step_m = max(extent.width_m, extent.depth_m) / _COLUMNS
    columns, rows = (max(2, round(side / step_m)) for side in (extent.width_m, extent.depth_m))
    xs, ys = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for low, high, count in zip(extent.low, extent.high, (columns, rows), strict=True)
    )
    quality_mm = 1e3 * quality_map(scene, plan, xs, ys)
    seen = np.isfinite(quality_mm)
    if not seen.any():
        return None
    best, worst = float(quality_mm[seen].min()), float(np.percentile(quality_mm[seen], _WORST_SHOWN))
    return axes.imshow(
        np.where(seen, quality_mm, np.nan),
        extent=(extent.low[0], extent.high[0], extent.low[1], extent.high[1]),
        origin="lower",
        cmap="viridis_r",
        alpha=0.6,
        norm=LogNorm(best, worst) if worst > _WIDE * best else Normalize(best, worst),
        interpolation="nearest",
        zorder=1,
    )


def _draw_limits(axes: Axes, place: Place, colour: str) -> None:
    """Draw where plans may put a camera: a drone's box, or the surface that a head may be mounted on."""
    match place:
        case DronePlace(box_m=(low, high)) | HeadPlace(mount_m=(low, high)):
            xs, ys = [low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]]
            axes.plot(xs, ys, color=colour, linestyle=(0, (1, 3)), linewidth=1.0, zorder=1.8)


def _draw_footprint(axes: Axes, scene: Scene, view: View, extent: Extent, colour: str, dash: str) -> None:
    cone = scene.settings.visibility == "cone"
    rim = cone_directions(view.alpha_rad, 256) if cone else rim_directions(view.lens, 64)
    farthest_m = 4.0 * float(np.linalg.norm(extent.high - extent.low))
    outline = rays_footprint(rim, view.T_world_camera, extent.height_m, farthest_m)
    if len(outline):
        style: dict[str, Any] = {"fill": False, "edgecolor": colour, "linestyle": dash, "linewidth": 1.4}
        axes.add_patch(Polygon(outline, **style, zorder=2, path_effects=_CASING))


def _draw_camera(axes: Axes, place: Place, view: View, extent: Extent, colour: str, words: Words) -> None:
    x, y = (float(value) for value in view.T_world_camera[:2, 3])
    marker, _ = SYMBOLS[type(place)]
    axes.plot(x, y, marker, color=colour, markeredgecolor="white", markersize=9, zorder=4.5)
    words.labels.append(Word(view.id, (x, y), colour))
    words.marks.append((x, y))
    longest_m = 0.09 * max(extent.width_m, extent.depth_m)
    if isinstance(place, DronePlace):
        step = 0.6 * longest_m * view.T_world_camera[:2, 0]
    else:
        axis = view.T_world_camera[:3, 2]
        foot = axis[:2] * abs((view.T_world_camera[2, 3] - extent.height_m) / min(axis[2], -1e-9))
        step = foot * min(1.0, longest_m / max(float(np.linalg.norm(foot)), 1e-9))
    if np.linalg.norm(step) > 0.25 * longest_m:
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.8, "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate("", (x + step[0], y + step[1]), (x, y), arrowprops=arrow, zorder=4.2)
        words.marks.append((x + float(step[0]), y + float(step[1])))


def _draw_targets(axes: Axes, scene: Scene, plan: RigPlan, colours: Mapping[str, str], words: Words) -> None:
    for target in scene.targets:
        at, quality = target.position_m[:2], plan.targets[target.id]
        words.marks.append(at)
        if quality.quality_m is None:
            axes.plot(*at, "X", color=RED, markeredgecolor="white", markersize=10, zorder=5)
            words.labels.append(Word(target.id, at, RED, is_target=True))
        else:
            if len(scene.targets) <= CROWD:
                _draw_sectors(axes, at, [colours[name] for name in quality.seen_by])
            else:
                axes.plot(*at, "o", color="black", markeredgecolor="white", markersize=4, zorder=5)
            words.labels.append(Word(f"{target.id}  {quality.quality_m * 1e3:.2f}", at, "black", is_target=True))


def _draw_sectors(axes: Axes, at: tuple[float, float], colours: Sequence[str]) -> None:
    """Draw a round mark with a sector for each colour, clockwise from the top."""
    axes.plot(*at, "o", color="white", markersize=_TARGET_PT + 2.5, zorder=5)
    width = 360.0 / len(colours)
    for number, colour in enumerate(colours):
        sector = Path.wedge(90.0 - width * (number + 1), 90.0 - width * number)
        # matplotlib draws a marker so that its farthest coordinate reaches the edge: a narrow sector's must not.
        size = _TARGET_PT * float(np.abs(sector.vertices).max())
        axes.plot(*at, marker=sector, color=colour, markersize=size, markeredgewidth=0.0, zorder=5.1)
    axes.plot(*at, "o", color="black", markeredgecolor="white", markersize=_TARGET_PT / 2.2, zorder=5.2)
