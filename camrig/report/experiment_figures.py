"""Figures of experiments: errors as boxes, what cameras see, figures against each other. Imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Polygon

from camrig.geometry.arrays import Array, GreyImage
from camrig.report.canvas import figure_of, save, style

_PANEL_INCHES = (2.3, 2.2)
_VIEW_INCHES = 2.6
_VIEW_PX = 480
_COLOURS = ("#8a8a8a", "#c9a227", "#b5533c", "#7a5195", "#2f7d5b", "#1f5fa8", "#444444", "#a05a2c")
_FOUND = "#ffb000"
_LEAST_MM = 1e-3
"""A logarithm needs one."""


def error_boxes(paths: Sequence[Path], rows: Mapping[str, Mapping[str, Mapping[str, Array]]]) -> None:
    """Draw errors in millimetres, (n,) by method, in a panel for every row and column of ``rows``, on one log scale.

    Boxes hold the middle half, whiskers 5 % to 95 %. Raises InputError for a file that cannot be written.
    """
    columns = list(dict.fromkeys(name for row in rows.values() for name in row))
    methods = list(dict.fromkeys(name for row in rows.values() for cell in row.values() for name in cell))
    width, height = _PANEL_INCHES
    with style():
        figure = figure_of(width * len(columns) + 0.8, height * len(rows) + 0.8)
        grid = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
        for axes_of_row, (title, row) in zip(grid, rows.items(), strict=True):
            for axes, column in zip(axes_of_row, columns, strict=True):
                cell = row.get(column, {})
                for k, method in enumerate(methods):
                    _box(axes, k, cell.get(method))
                axes.set_yscale("log")
                axes.grid(visible=True, axis="y", alpha=0.3)
                axes.set_xticks([])
                axes.set_title(f"{column}, {title}")
        for axes_of_row in grid:
            axes_of_row[0].set_ylabel("3-D error, mm")
        handles = [Patch(facecolor=_colour(k), alpha=0.75, label=method) for k, method in enumerate(methods)]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(methods), 4), frameon=False)
        figure.draw_without_rendering()
        for path in paths:
            save(figure, path)


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """A camera's picture and the corners (n, 4, 2) of the tags found in it."""

    title: str
    image: GreyImage
    corners_px: Array


def camera_views(paths: Sequence[Path], rows: Mapping[str, Sequence[CameraView]]) -> None:
    """Draw what cameras see side by side, in a row for every title, tags that were found outlined.

    Raises InputError for a file that cannot be written.
    """
    columns = max(len(views) for views in rows.values())
    height, width = next(iter(rows.values()))[0].image.shape
    with style():
        figure = figure_of(_VIEW_INCHES * columns, len(rows) * (_VIEW_INCHES * height / width + 0.35))
        grid = figure.subplots(len(rows), columns, squeeze=False)
        for axes_of_row, (title, views) in zip(grid, rows.items(), strict=True):
            for axes in axes_of_row:
                axes.set_axis_off()
            for axes, view in zip(axes_of_row, views, strict=False):
                _draw_view(axes, f"{title}: {view.title}", view)
        figure.draw_without_rendering()
        for path in paths:
            save(figure, path)


def _draw_view(axes: Axes, title: str, view: CameraView) -> None:
    height, width = view.image.shape
    scale = _VIEW_PX / width
    smaller = cv2.resize(view.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    axes.imshow(smaller, cmap="gray", vmin=0, vmax=255, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    for corners in view.corners_px:
        axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=_FOUND, linewidth=1.2))
    axes.set_title(title, fontsize=8.0)


def _box(axes: Axes, k: int, errors_mm: Array | None) -> None:
    if errors_mm is None or not len(errors_mm):
        return
    axes.boxplot(
        [np.maximum(errors_mm, _LEAST_MM)],
        positions=[k],
        widths=0.65,
        whis=(5.0, 95.0),
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": _colour(k), "alpha": 0.75},
        medianprops={"color": "black"},
    )


def _colour(k: int) -> str:
    return _COLOURS[k % len(_COLOURS)]
