"""The page of ``camrig calibrate extrinsics --report``."""

from __future__ import annotations

import numpy as np

from camrig.cli.extrinsics_answer import COLUMNS, Answer
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL
from camrig.geometry.pose import transform
from camrig.report.calibration import CalibrationReport, Drawing, Table
from camrig.report.extrinsics_figures import Residuals, RigPicture, ViewGraph


def page(answer: Answer, made: str) -> CalibrationReport:
    """Return the page."""
    found = answer.found
    verdict, reasons = answer.verdict()
    first, *others = answer.facts()
    facts = {
        "rig": answer.rig.name,
        "pictures": first,
        "one sigma of corners": f"{found.noise_px:.3f} px",
        "world": "anchors" if found.anchored else ", ".join(answer.setup.kept) or "the first camera: nothing said it",
        **{f"note {k + 1}": fact for k, fact in enumerate(others)},
    }
    residuals = {name: found.of_camera(name) for name in found.placed_cameras}
    sizes = {name: answer.setup.lenses[name].size_px for name in residuals}
    arrows = Residuals(residuals, sizes)
    sections = (
        _cameras(answer),
        Drawing(
            "The rig", _rig(answer).draw, (8.0, 4.2), "Cameras blue, tags of the room brown, what was carried grey."
        ),
        Drawing(
            "Who is tied to whom",
            ViewGraph(answer.asked, found.shared, answer.missing).draw,
            (4.5, 4.5),
            "Instants and tags that two cameras share; dashed: what is missing.",
        ),
        Drawing(
            "Residuals",
            arrows.draw,
            (8.0, 2.6 * -(-len(residuals) // 3)),
            f"From where corners were seen to where they should be, {arrows.enlarged:.0f} times as long.",
        ),
        _marks(answer),
    )
    return CalibrationReport(f"Where the cameras of {answer.rig.name} are", verdict, reasons, facts, sections, made)


def _rig(answer: Answer) -> RigPicture:
    found = answer.found
    ahead = transform(R_MOUNT_OPTICAL, np.zeros(3))
    cameras = {name: pose.T for name, pose in found.cameras.items()}
    heads = {f"{name} (head)": pose.T @ ahead for name, pose in found.bases.items()}
    carried = np.array([T[:3, 3] for T in found.T_world_body.values()]).reshape(-1, 3)
    return RigPicture({**cameras, **heads}, {name: mark.T for name, mark in found.room.items()}, carried)


def _cameras(answer: Answer) -> Table:
    return Table("Cameras", COLUMNS, list(answer.rows()), "± is one sigma, of what the corners' noise leaves open.")


def _marks(answer: Answer) -> Table:
    found = answer.found
    misses: dict[str, list[float]] = {}
    for each, off in zip(found.sighted, found.residual_px, strict=True):
        misses.setdefault(each.mark, []).extend(np.linalg.norm(off, axis=1))
    rows = [
        (mark, found.body_of[mark] or "the room", str(len(off)), f"{np.median(off):.2f}", f"{np.max(off):.2f}")
        for mark, off in sorted(misses.items())
    ]
    return Table("Marks", ("mark", "on", "corners", "median miss px", "largest px"), rows)
