"""How good corners are, the detector's and refined ones, by the tag's width and its place in the picture.

    python -m tests.corner_study --tags 3000 --seed 1

draws tag36h11 through the lab lens as exactly as tests.drawn_tags does and prints the table of docs/accuracy.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from rich.console import Console
from rich.progress import track

from camrig.detect import detect_tags
from camrig.geometry.arrays import Array
from camrig.geometry.corner_noise import refined_sigma_px, tag_width_px
from camrig.messages import Frame, TagDetection, Window
from camrig.plugins import load_plugin
from camrig.rig import TagKey
from tests.drawn_tags import DrawnTag, draw_tag, random_pose
from tests.lenses import LAB

WIDTHS_PX = (16.0, 18.0, 20.0, 22.0, 25.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0, 140.0)
RADII = (0.0, 0.25, 0.5, 0.85)
"""tan of the angle off the axis: 0, 14, 27, 40 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenCorners:
    """One tag's true width and place, and how far its corners are off: the detector's and after refinement, (4, 2)."""

    width_px: float
    radius: float
    detected_px: Array
    refined_px: Array
    refined: tuple[bool, ...]


def seen_tags(count: int, seed: int) -> Iterator[SeenCorners]:
    """Draw ``count`` tags, their widths even in the logarithm; yield those that are found."""
    rng = np.random.default_rng(seed)
    plugin = load_plugin("detectors", "pyapriltags")
    detector = plugin.make(plugin.section())
    for _ in range(count):
        drawn = None
        while drawn is None:
            width_px = float(np.exp(rng.uniform(np.log(WIDTHS_PX[0]), np.log(WIDTHS_PX[-1]))))
            T_camera_tag = random_pose(LAB, rng, width_px, rng.uniform(RADII[0], RADII[-1]))
            drawn = draw_tag(LAB, T_camera_tag, rng, key=TagKey("tag36h11", int(rng.integers(500))))
        frame = Frame("c", drawn.image, 0.0, 0)
        before, after = (
            detect_tags(frame, detector, lambda: 0.0, [Window(drawn.region)], lens).tags for lens in (None, LAB)
        )
        if len(before) == 1:
            yield _compared(drawn, before[0], after[0])


def _compared(drawn: DrawnTag, before: TagDetection, after: TagDetection) -> SeenCorners:
    true = drawn.corners_px
    radius = float(np.hypot(*LAB.unproject(true).mean(axis=0)))
    return SeenCorners(
        float(tag_width_px(true)), radius, before.corners_px - true, after.corners_px - true, after.refined
    )


def rms(errors: Array) -> float:
    """Return the root mean square, per coordinate; NaN of none."""
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else float("nan")


def in_bin(seen: Sequence[SeenCorners], widths: tuple[float, float], radii: tuple[float, float]) -> list[SeenCorners]:
    """Return what lies between two widths and two radii."""
    return [tag for tag in seen if widths[0] <= tag.width_px < widths[1] and radii[0] <= tag.radius < radii[1]]


def errors(seen: Sequence[SeenCorners]) -> tuple[Array, Array, Array]:
    """Return errors (n, 4, 2) of the detector's corners, of what is published, and which (n, 4) were refined."""
    return (
        np.array([tag.detected_px for tag in seen]).reshape(-1, 4, 2),
        np.array([tag.refined_px for tag in seen]).reshape(-1, 4, 2),
        np.array([tag.refined for tag in seen], dtype=bool).reshape(-1, 4),
    )


def table(seen: Sequence[SeenCorners]) -> str:
    """Return RMS errors in pixels as Markdown: the detector's / published corners, by width and place; then by width
    the refined ones alone, their share, and the law.
    """
    places = list(pairwise(RADII))
    head = [f"to {np.degrees(np.arctan(high)):.0f} deg" for _, high in places]
    lines = [
        " | ".join(["| width px", "n", *head, "refined alone", "share", "law |"]),
        "|--" * (len(places) + 5) + "|",
    ]
    for low, high in pairwise(WIDTHS_PX):
        row = in_bin(seen, (low, high), (0.0, np.inf))
        cells = [f"| {low:.0f} to {high:.0f}", f"{len(row)}"]
        for place in places:
            detected, published, _ = errors(in_bin(row, (low, high), place))
            cells.append(f"{rms(detected):.3f} / {rms(published):.3f}" if detected.size else "-")
        _, published, refined = errors(row)
        law = float(refined_sigma_px(np.asarray(np.sqrt(low * high))))
        alone = f"{rms(published[refined]):.4f}" if refined.any() else "-"
        share = f"{refined.mean():.2f}" if row else "-"
        lines.append(" | ".join([*cells, alone, share, f"{law:.4f} |"]))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Corner errors by tag width and place in the picture.")
    parser.add_argument("--tags", type=int, default=3000, help="tags to draw [3000]")
    parser.add_argument("--seed", type=int, default=1, help="of poses and noise [1]")
    asked = parser.parse_args()
    progress = track(seen_tags(asked.tags, asked.seed), "drawing", asked.tags, console=Console(stderr=True))
    print(table(list(progress)))


if __name__ == "__main__":
    main()
