"""How a calibrated lens is told: as JSON, and as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from rich.markup import escape
from rich.table import Table

from camrig.calibrate.boards import board_word
from camrig.calibrate.intrinsics import Intrinsics
from camrig.calibrate.lens_evidence import difference_px
from camrig.cli.board_shots import BoardShots
from camrig.cli.console import COLOURS, people, results
from camrig.geometry.lens import FisheyeLens, Lens
from camrig.report.intrinsics_report import facts_of, verdict_of

_SHOWN = 8
"""Pictures set aside that are listed; the rest is counted."""


def as_json(found: Intrinsics, seen: BoardShots, last: Lens | None, written: Sequence[str]) -> dict[str, object]:
    """Return the JSON object of docs/calibrate-intrinsics.md."""
    (fx, fy), (cx, cy) = found.lens.focal_px, found.lens.centre_px
    change = None if last is None else difference_px(found.lens, last)
    return {
        "rms_px": round(found.fit.rms_px, 4),
        "heldout_rms_px": round(found.chosen.heldout_rms_px, 4),
        "views": len(found.used),
        "rejected": list(found.rejected),
        "model": found.fit.form.name,
        "lens": "fisheye" if isinstance(found.lens, FisheyeLens) else "brown",
        "size_px": list(found.lens.size_px),
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
        "distortion": list(found.distortion),
        "r_max": found.lens.r_max,
        "sigma": found.sigma,
        "board": board_word(seen.board),
        "reasons": dict(found.rejected),
        "without_board": list(seen.without),
        "unreadable": list(seen.faults),
        "coverage": round(found.gauges.coverage, 3),
        "tilt_deg": round(float(np.degrees(found.gauges.tilt_rad)), 1),
        "mm_at_3m": {
            "median": round(float(np.nanmedian(found.sideways_mm)), 3),
            "worst": round(float(np.nanmax(found.sideways_mm)), 3),
        },
        "change_px": change,
        "verdict": str(verdict_of(found)),
        "warnings": [concern.text for concern in found.concerns],
        "written": list(written),
    }


def print_lens(found: Intrinsics, seen: BoardShots, last: Lens | None, entry: Mapping[str, Any]) -> None:
    """Print the lens, its worth, and the lines for a rig's file."""
    table = Table("", "", title=f"Lens from {board_word(seen.board)}", show_header=False)
    for name, value in facts_of(found).items():
        table.add_row(name, escape(value))
    if last is not None:
        table.add_row("last run", _compared(found, last))
    results.print(table)
    line = yaml.safe_dump(dict(entry), default_flow_style=True, sort_keys=False, width=10_000).strip()
    results.print(f"lens: {line}", markup=False, highlight=False, soft_wrap=True)
    for name, why in list(found.rejected.items())[:_SHOWN]:
        people.print(f"set aside: {name} {why}", markup=False, soft_wrap=True, highlight=False)
    if len(found.rejected) > _SHOWN:
        people.print(f"set aside: {len(found.rejected) - _SHOWN} more; --report lists all", markup=False)
    if seen.without:
        listed = ", ".join(seen.without[:_SHOWN]) + (" ..." if len(seen.without) > _SHOWN else "")
        people.print(f"without the board: {len(seen.without)} ({listed})", markup=False, soft_wrap=True)
    verdict = verdict_of(found)
    colour = COLOURS[verdict]
    people.print(f"[{colour}]{verdict}[/{colour}]")
    for concern in found.concerns:
        people.print(f"warning: {concern.text}", style="yellow", markup=False, soft_wrap=True)


def _compared(found: Intrinsics, last: Lens) -> str:
    change = difference_px(found.lens, last)
    if change is None:
        return f"was for {last.size_px[0]}x{last.size_px[1]} px"
    fx, cx, cy = last.focal_px[0], *last.centre_px
    return (
        f"fx {fx:.2f}, centre {cx:.2f}, {cy:.2f} px; directions differ by {change['median']:.2f} px (median; "
        f"worst {change['worst']:.2f}) after the best turn"
    )
