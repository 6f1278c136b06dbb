"""Figures of plans: one plan with all its words, or several side by side. Imports matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FormatStrFormatter, LogLocator

from camrig.messages import RigPlan
from camrig.optimise import Scene
from camrig.report.canvas import figure_of, save, style
from camrig.report.plan_axes import BOX, COLOURS, CROWD, NOWHERE, RED, SYMBOLS, Extent, Words, draw_plan, extent_of
from camrig.report.plan_labels import place_labels
from camrig.report.plan_map import QUALITY_UNITS

_LONG_INCHES, _SHORT_INCHES = 8.0, 3.0
"""What the longer side of a room takes, and the least that the shorter one gets."""
_PANEL_INCHES = 4.2


def write_map(path: Path, title: str, scene: Scene, plan: RigPlan) -> None:
    """Draw one plan; raises InputError where the file cannot be written."""
    extent = extent_of(scene, plan)
    longest_m = max(extent.width_m, extent.depth_m)
    width, height = (
        max(_SHORT_INCHES, _LONG_INCHES * side_m / longest_m) for side_m in (extent.width_m, extent.depth_m)
    )
    with style():
        figure = figure_of(width + 1.6, height + 1.3)
        axes = figure.add_subplot()
        words = _draw(figure, axes, f"{title}: {_summary(scene, plan)}", scene, plan, extent)
        figure.legend(handles=_legend(scene, plan), loc="outside lower center", ncols=3, frameon=False)
        figure.draw_without_rendering()
        place_labels(axes, words)
        save(figure, path)


def write_panel(path: Path, panels: Sequence[tuple[str, Scene, RigPlan]]) -> None:
    """Draw several plans, up to three in a row; raises InputError where the file cannot be written."""
    columns = min(3, math.ceil(math.sqrt(len(panels))))
    rows = math.ceil(len(panels) / columns)
    extents = [extent_of(scene, plan) for _, scene, plan in panels]
    shape = float(np.clip(max(each.depth_m / each.width_m for each in extents), 0.4, 1.5))
    with style():
        figure = figure_of(columns * (_PANEL_INCHES + 1.3), rows * (_PANEL_INCHES * shape + 1.1))
        drawn = []
        for number, ((title, scene, plan), extent) in enumerate(zip(panels, extents, strict=True), 1):
            axes = figure.add_subplot(rows, columns, number)
            words = _draw(figure, axes, f"{title}\n{_summary(scene, plan)}", scene, plan, extent)
            drawn.append((axes, words.without_targets()))
        figure.draw_without_rendering()
        for axes, words in drawn:
            place_labels(axes, words)
        save(figure, path)


def _draw(figure: Figure, axes: Axes, title: str, scene: Scene, plan: RigPlan, extent: Extent) -> Words:
    painted, words = draw_plan(axes, scene, plan, extent)
    axes.set_title(title)
    if painted is not None:
        beside = axes.inset_axes((1.02, 0.0, 0.03, 1.0))
        label = f"quality of a target at z = {extent.height_m:.2f} m, {QUALITY_UNITS[scene.settings.quality]}"
        bar = figure.colorbar(painted, cax=beside, label=label, extend="max", extendfrac=0.03)
        if isinstance(painted.norm, LogNorm):
            bar.set_ticks(LogLocator(subs=(1.0, 2.0, 5.0)), minor=False)
            bar.minorticks_off()
            bar.formatter = FormatStrFormatter("%g")
    return words


def _summary(scene: Scene, plan: RigPlan) -> str:
    covered = f"{len(plan.targets) - len(plan.uncovered)} of {len(plan.targets)} covered"
    if plan.objective_m is None:
        return f"{plan.status.value}, {covered}"
    unit = QUALITY_UNITS[scene.settings.quality]
    return f"{plan.status.value}, {scene.settings.objective} {plan.objective_m * 1e3:.3f} {unit}, {covered}"


def _legend(scene: Scene, plan: RigPlan) -> list[Line2D | Patch]:
    kinds = dict.fromkeys(type(camera.place) for camera in scene.cameras)
    handles: list[Line2D | Patch] = [_symbol(*SYMBOLS[kind]) for kind in kinds]
    if len(scene.targets) <= CROWD:
        target = _symbol("o", "target, its quality, and in colour who sees it")
        target.set(markersize=8.0, markeredgewidth=3.0, markeredgecolor=COLOURS[0])
    else:
        target = _symbol("o", "target")
    handles.append(target)
    if plan.uncovered:
        handles.append(Line2D([], [], linestyle="", marker="X", color=RED, label="target nobody sees"))
    if scene.anchors:
        handles.append(_symbol("P", "anchor"))
    if scene.keep_out_m:
        handles.append(Patch(**BOX, label="keep-out box"))
    handles.append(Patch(facecolor=NOWHERE, label="place nobody sees"))
    return handles


def _symbol(marker: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="", marker=marker, color="black", label=label)
