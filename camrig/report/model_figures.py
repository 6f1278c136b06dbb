"""Figures of quality models: promised against real errors, floor maps, sensor density. Imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from camrig.geometry.arrays import Array
from camrig.geometry.lens import Lens
from camrig.report.canvas import figure_of, save, style
from camrig.sensing import q_d, q_p

_HEIGHT_M = 3.0
_REACH_M = (3.4, 2.2)
_STEP_M = 0.02
_DENSITY_STEP_PX = 8


def promises(paths: Sequence[Path], panels: Mapping[str, Array]) -> None:
    """Draw errors over what was promised of them, (n, 2) [promise, error] in millimetres by title, on log scales."""
    columns = 3
    rows = -(-len(panels) // columns)
    with style():
        figure = figure_of(3.0 * columns, 2.8 * rows)
        grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        for axes, (title, pairs) in zip(grid.flat, panels.items(), strict=False):
            axes.set_axis_on()
            axes.loglog(pairs[:, 0], pairs[:, 1], ".", markersize=2.5, alpha=0.5)
            low, high = float(pairs[:, 0].min()), float(pairs[:, 0].max())
            axes.plot([low, high], [low, high], color="black", linewidth=0.8)
            axes.set_title(title)
            axes.set_xlabel("promised, mm")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 3.0) if axis is axes.xaxis else (1.0,)))
                axis.set_major_formatter(FormatStrFormatter("%g"))
                axis.set_minor_formatter(NullFormatter())
        for row in grid:
            row[0].set_ylabel("error, mm")
        _finish(figure, paths)


def floor_maps(paths: Sequence[Path], lens: Lens) -> None:
    """Draw the paper's maps of the floor below a camera 3 m up (perspective, distortion, both), and how many pixels of
    the sensor fall on a unit of the ideal image.
    """
    with style():
        figure = figure_of(11.0, 7.4)
        grid = figure.subplots(2, 2)
        along_x, along_y = (np.arange(-reach_m, reach_m, _STEP_M) for reach_m in _REACH_M)
        ideal = np.stack(np.meshgrid(along_x, along_y), axis=-1) / _HEIGHT_M
        seen = _in_picture(lens, ideal)
        perspective = np.broadcast_to(q_p(lens, np.array(_HEIGHT_M)), seen.shape)
        distortion = q_d(lens, ideal)
        for axes, title, values in (
            (grid[0, 0], "perspective q_p, mm/px", 1e3 * perspective),
            (grid[0, 1], "distortion q_d", distortion),
            (grid[1, 0], "complete, Q = q_p q_d, mm/px", 1e3 * perspective * distortion),
        ):
            extent = (-_REACH_M[0], _REACH_M[0], -_REACH_M[1], _REACH_M[1])
            _paint(figure, axes, np.where(seen, values, np.nan), extent, title)
            axes.set_xlabel("x on the floor, m, 3 m below the camera")
            axes.set_ylabel("y, m")
        width, height = lens.size_px
        columns, rows = (np.arange(0, size, _DENSITY_STEP_PX, dtype=float) for size in lens.size_px)
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
        density = np.linalg.det(lens.jacobian(lens.unproject(pixels)))
        _paint(figure, grid[1, 1], density[::-1], (0.0, width, height, 0.0), "sensor density, 1 in the middle")
        grid[1, 1].set_xlabel("column of the picture, px")
        grid[1, 1].set_ylabel("row, px")
        _finish(figure, paths)


def _in_picture(lens: Lens, ideal: Array) -> Array:
    points = np.concatenate([ideal, np.ones((*ideal.shape[:-1], 1))], axis=-1)
    pixels = lens.project(points)
    return np.asarray(((pixels >= 0.0) & (pixels <= np.asarray(lens.size_px) - 1.0)).all(axis=-1))


def _paint(figure: Figure, axes: Axes, values: Array, extent: tuple[float, float, float, float], title: str) -> None:
    painted = axes.imshow(values, extent=extent, origin="lower", cmap="viridis")
    figure.colorbar(painted, ax=axes, shrink=0.9)
    axes.set_title(title)


def _finish(figure: Figure, paths: Sequence[Path]) -> None:
    figure.draw_without_rendering()
    for path in paths:
        save(figure, path)
