"""Figures of an extrinsic calibration: the rig from above and from the side, residuals, who is tied to whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pnp import TAG_CORNERS

_LOOK = 0.12
"""Length of a camera's view in the picture, over the picture's width."""

_ARROW = 0.05
"""Of a picture's width the median residual is drawn at most so long."""

_MOST_ARROWS = 600


@dataclass(frozen=True, slots=True, eq=False)
class RigPicture:
    """Cameras (and heads) with where they look, marks that stand, and where bodies were carried, all in the world."""

    T_world_camera: Mapping[str, Transform]
    T_world_mark: Mapping[str, Transform]
    carried_m: Array

    def draw(self, figure: Any) -> None:
        """Draw it from above and from the south."""
        for at, (axes, first, second, words) in enumerate(
            [
                (figure.add_subplot(1, 2, 1), 0, 1, "from above: x, y in m"),
                (figure.add_subplot(1, 2, 2), 0, 2, "x, z in m"),
            ]
        ):
            self._draw_view(axes, first, second, named=at == 0)
            axes.set_title(words)
            axes.set_aspect("equal", adjustable="datalim")
            axes.grid(visible=True, linewidth=0.4)

    def _draw_view(self, axes: Any, first: int, second: int, *, named: bool) -> None:
        places = np.array([T[:3, 3] for T in (*self.T_world_camera.values(), *self.T_world_mark.values())])
        length = _LOOK * max(float(np.ptp(places, axis=0).max()), 0.5)
        if len(self.carried_m):
            axes.plot(self.carried_m[:, first], self.carried_m[:, second], ".", color="#999999", markersize=2)
        for name, T in self.T_world_mark.items():
            axes.plot(T[first, 3], T[second, 3], "s", color="#b23c00", markersize=5)
            if named and len(self.T_world_mark) < 30:
                axes.annotate(
                    name.rpartition(":")[2],
                    (T[first, 3], T[second, 3]),
                    fontsize=6,
                    xytext=(3, 3),
                    textcoords="offset points",
                )
        for name, T in self.T_world_camera.items():
            for corner in np.array([[-0.5, -0.35, 1.0], [0.5, -0.35, 1.0], [0.5, 0.35, 1.0], [-0.5, 0.35, 1.0]]):
                end = T[:3, 3] + length * T[:3, :3] @ corner
                axes.plot([T[first, 3], end[first]], [T[second, 3], end[second]], color="#0057a3", linewidth=0.7)
            axes.plot(T[first, 3], T[second, 3], "o", color="#0057a3", markersize=4)
            if named:
                axes.annotate(name, (T[first, 3], T[second, 3]), fontsize=7, xytext=(4, 4), textcoords="offset points")


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """By camera: (k, 4) pixels and residuals side by side, and the picture's size."""

    of_camera: Mapping[str, Array]
    size_px: Mapping[str, tuple[int, int]]

    @property
    def enlarged(self) -> float:
        """Return how many times as long as they are arrows are drawn: a power of ten."""
        lengths = np.concatenate([np.linalg.norm(rows[:, 2:], axis=1) for rows in self.of_camera.values()])
        widest = max(width for width, _ in self.size_px.values())
        return float(10.0 ** np.floor(np.log10(_ARROW * widest / max(float(np.median(lengths)), 1e-6))))

    def draw(self, figure: Any) -> None:
        """Draw arrows over each camera's picture."""
        names = list(self.of_camera)
        columns = min(len(names), 3)
        for k, name in enumerate(names):
            axes = figure.add_subplot(-(-len(names) // columns), columns, k + 1)
            rows = self.of_camera[name]
            some = rows[:: 1 + len(rows) // _MOST_ARROWS]
            axes.quiver(*some.T, angles="xy", scale_units="xy", scale=1.0 / self.enlarged, width=0.003, color="#0057a3")
            width, height = self.size_px[name]
            axes.set_xlim(0, width)
            axes.set_ylim(height, 0)
            axes.set_aspect("equal")
            axes.set_title(f"{name}: rms {np.sqrt(np.square(rows[:, 2:]).sum(axis=1).mean()):.2f} px")


@dataclass(frozen=True, slots=True, eq=False)
class ViewGraph:
    """Cameras on a circle, and how much ties each two; the links that are missing are dashed and red."""

    names: Sequence[str]
    shared: Mapping[tuple[str, str], int]
    missing: Sequence[tuple[str, str]]

    def draw(self, figure: Any) -> None:
        """Draw it."""
        axes = figure.add_subplot()
        angles = 2.0 * np.pi * np.arange(len(self.names)) / max(len(self.names), 1)
        at = {
            name: (float(np.cos(angle)), float(np.sin(angle))) for name, angle in zip(self.names, angles, strict=True)
        }
        most = max(self.shared.values(), default=1) or 1
        for (a, b), count in self.shared.items():
            if count:
                (xa, ya), (xb, yb) = at[a], at[b]
                axes.plot([xa, xb], [ya, yb], color="#0057a3", linewidth=0.5 + 4.0 * count / most, alpha=0.6, zorder=1)
                middle = (0.55 * xa + 0.45 * xb, 0.55 * ya + 0.45 * yb)
                axes.annotate(str(count), middle, fontsize=7, ha="center", va="center", backgroundcolor="white")
        for a, b in self.missing:
            axes.plot(*zip(at[a], at[b], strict=True), "--", color="#d40000", linewidth=1.5, zorder=1)
        for name, (x, y) in at.items():
            axes.plot(x, y, "o", color="black", zorder=2)
            axes.annotate(name, (1.15 * x, 1.15 * y), ha="center", va="center")
        axes.set_xlim(-1.5, 1.5)
        axes.set_ylim(-1.5, 1.5)
        axes.set_aspect("equal")
        axes.axis("off")


@dataclass(frozen=True, slots=True, eq=False)
class BodyPicture:
    """The tags of a body by name: ``T_body_tag`` and size in metres."""

    tags: Mapping[str, tuple[Transform, float]]

    def draw(self, figure: Any) -> None:
        """Draw it from above, from the front (-y) and from the side (x), in mm."""
        for at, (first, second, words) in enumerate([(0, 1, "x, y"), (0, 2, "x, z"), (1, 2, "y, z")]):
            axes = figure.add_subplot(1, 3, at + 1)
            for k, (name, (T, size_m)) in enumerate(self.tags.items()):
                corners = 1e3 * (size_m * np.vstack([TAG_CORNERS, TAG_CORNERS[:1]]) @ T[:3, :3].T + T[:3, 3])
                axes.plot(corners[:, first], corners[:, second], color=f"C{k % 10}", linewidth=1.2)
                middle = (1e3 * T[first, 3], 1e3 * T[second, 3])
                axes.annotate(name.rpartition(":")[2], middle, ha="center", va="center", fontsize=7, color=f"C{k % 10}")
            axes.set_title(words)
            axes.set_aspect("equal", adjustable="datalim")
            axes.grid(visible=True, linewidth=0.4)
