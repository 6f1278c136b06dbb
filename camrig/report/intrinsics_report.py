"""The page of a lens's calibration: the lens, what it is worth, each picture, and where its points miss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from camrig.calibrate.intrinsics import DISTANCE_M, Intrinsics
from camrig.calibrate.lens_evidence import picture_grid
from camrig.calibrate.shots import Shot
from camrig.geometry.arrays import Array
from camrig.messages import Verdict
from camrig.report.calibration import CalibrationReport, Drawing, Table

_ARROWS = 60.0
"""Residuals are drawn longer by this."""


def verdict_of(found: Intrinsics) -> Verdict:
    """Return what the calibration is good for."""
    if any(concern.severe for concern in found.concerns):
        return Verdict.RED
    return Verdict.AMBER if found.concerns else Verdict.GREEN


def facts_of(found: Intrinsics) -> dict[str, str]:
    """Return what people want to know of a lens, in words."""
    fit, sigma = found.fit, found.sigma
    (fx, fy), (cx, cy) = found.lens.focal_px, found.lens.centre_px
    median_mm, worst_mm = np.nanmedian(found.sideways_mm), np.nanmax(found.sideways_mm)
    return {
        "model": fit.form.name,
        "fx, fy": f"{fx:.2f} ± {sigma['fx']:.2f}, {fy:.2f} ± {sigma['fy']:.2f} px",
        "cx, cy": f"{cx:.2f} ± {sigma['cx']:.2f}, {cy:.2f} ± {sigma['cy']:.2f} px",
        "distortion": ", ".join(f"{value:.5g}" for value in found.distortion) or "none",
        "rms": f"{fit.rms_px:.3f} px; held out {found.chosen.heldout_rms_px:.3f} px",
        "pictures": f"{len(found.used)} used, {len(found.rejected)} set aside",
        "coverage": f"{100.0 * found.gauges.coverage:.0f} % of the picture; tilts up to "
        f"{np.degrees(found.gauges.tilt_rad):.0f} deg to {found.gauges.sides} of 4 sides; "
        f"sizes 1 : {found.gauges.size_ratio:.1f}",
        f"at {DISTANCE_M:g} m": f"{median_mm:.1f} mm sideways (one sigma; median of the picture, worst {worst_mm:.1f})",
        "r_max": f"{found.lens.r_max:.3f}",
    }


def intrinsics_report(title: str, found: Intrinsics, shots: Sequence[Shot], made: str) -> CalibrationReport:
    """Return the page."""
    reasons = [concern.text for concern in found.concerns] or ["nothing speaks against it"]
    edges = {shot.name: shot.edge_px for shot in shots}
    seen = [shot.view.corners_px for shot in shots]
    return CalibrationReport(
        title=title,
        verdict=verdict_of(found),
        reasons=reasons,
        facts=facts_of(found),
        sections=(
            Drawing("Where points were seen, and by how much they miss", lambda figure: _residuals(figure, found),
                    (7.0, 5.2), f"Arrows are {_ARROWS:.0f} times as long as the residuals."),
            Drawing("Residuals", lambda figure: _cloud(figure, found), (7.0, 3.2),
                    "Left: both axes. Right: along the radius, over the distance from the centre; a lens of too few "
                    "numbers shows as a wave."),
            Drawing("Uncertainty over the picture", lambda figure: _map(figure, found, seen), (7.0, 4.6),
                    f"One sigma sideways at {DISTANCE_M:g} m, in mm, on a log scale; dots are the board's points."),
            Drawing("Distortion", lambda figure: _distortion(figure, found), (7.0, 3.2),
                    "By how many pixels the lens bends, over the angle off its axis, up to r_max."),
            Table("Lenses tried", ("numbers", "model", "rms px", "held out px", "map px"), _tried(found),
                  "Chosen: the best at pictures held out, where each number must lower their rms by 0.2 %, among those "
                  "that know the whole picture."),
            Table("Pictures", ("picture", "rms px", "points", "edge px"), _pictures(found, edges)),
            Table("Set aside", ("picture", "why"), list(found.rejected.items()) or [("none", "")]),
        ),
        made=made,
    )  # fmt: skip


def _tried(found: Intrinsics) -> list[tuple[str, ...]]:
    return [
        (
            f"{each.fit.form.basis.shape[1]}",
            each.fit.form.name + (" (chosen)" if each is found.chosen else ""),
            f"{each.fit.rms_px:.4f}",
            f"{each.heldout_rms_px:.4f}",
            f"{each.map_rms_px:.2f}",
        )
        for each in found.tried
    ]


def _pictures(found: Intrinsics, edges: Mapping[str, float]) -> list[tuple[str, ...]]:
    counts = found.fit.points.there.sum(axis=1)
    rows = zip(found.used, found.fit.rms_by_picture_px, counts, strict=True)
    return [(name, f"{rms:.3f}", str(count), f"{edges[name]:.1f}") for name, rms, count in rows]


def _residuals(figure: Any, found: Intrinsics) -> None:
    axes, there = figure.subplots(), found.fit.points.there
    at, miss = found.fit.points.seen_px[there], found.fit.residual_px[there]
    axes.quiver(at[:, 0], at[:, 1], *(_ARROWS * miss.T), angles="xy", scale_units="xy", scale=1.0, width=0.0015)
    _picture_axes(axes, found)


def _cloud(figure: Any, found: Intrinsics) -> None:
    left, right = figure.subplots(1, 2)
    there = found.fit.points.there
    at, miss = found.fit.points.seen_px[there] - np.asarray(found.lens.centre_px), found.fit.residual_px[there]
    left.plot(miss[:, 0], miss[:, 1], ".", markersize=2)
    left.set_aspect("equal", "datalim")
    left.set_xlabel("x, px")
    left.set_ylabel("y, px")
    radius = np.linalg.norm(at, axis=-1)
    along = (at * miss).sum(axis=-1) / np.maximum(radius, 1e-9)
    right.plot(radius, along, ".", markersize=2)
    right.axhline(0.0, color="black", linewidth=0.6)
    right.set_xlabel("distance from the centre, px")
    right.set_ylabel("along the radius, px")


def _map(figure: Any, found: Intrinsics, seen: Sequence[Array]) -> None:
    axes = figure.subplots()
    grid = picture_grid(found.lens.size_px)
    values = np.ma.masked_invalid(np.log10(np.maximum(found.sideways_mm, 1e-3)))
    painted = axes.pcolormesh(grid[..., 0], grid[..., 1], values, shading="nearest", cmap="viridis")
    bar = figure.colorbar(painted, ax=axes)
    low, high = painted.get_clim()
    ticks = [tick for tick in bar.get_ticks() if low <= tick <= high]
    bar.set_ticks(ticks, labels=[f"{10.0**tick:.2g}" for tick in ticks])
    bar.set_label("mm")
    points = np.concatenate(list(seen))
    axes.plot(points[:, 0], points[:, 1], ".", color="white", markersize=1.5)
    _picture_axes(axes, found)


def _distortion(figure: Any, found: Intrinsics) -> None:
    axes = figure.subplots()
    radius = np.linspace(0.0, found.lens.r_max, 100)
    ideal = np.stack([radius, np.zeros_like(radius)], axis=-1)
    bend_px = (found.lens.distort(ideal)[:, 0] - radius) * found.lens.focal_px[0]
    axes.plot(np.degrees(np.arctan(radius)), bend_px)
    axes.set_xlabel("angle off the axis, deg")
    axes.set_ylabel("bend, px")
    axes.grid(linewidth=0.3)


def _picture_axes(axes: Any, found: Intrinsics) -> None:
    width, height = found.lens.size_px
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_aspect("equal")
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")
