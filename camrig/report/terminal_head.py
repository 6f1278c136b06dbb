"""One head in a terminal, as its camera looks: left is left, up is up. For the person on the ladder."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.text import Text

COLUMNS, ROWS = 61, 13
"""Odd, so that the middle of the limits has a place of its own; all in all it fits 24 lines."""
HERE, WANTED, BOTH = "O", "X", "@"
AT_REST_DEG = 0.05

Angles = tuple[float, float]
"""Pan, positive to the left, and tilt, positive up, in degrees."""


@dataclass(frozen=True)
class HeadPicture:
    """What is shown of a head; ``None`` is unknown, or nowhere wanted."""

    name: str
    pan_limits_deg: Angles
    tilt_limits_deg: Angles
    present_deg: Angles | None
    sigma_deg: Angles | None
    wanted_deg: Angles | None
    state: str
    """Who controls it, and how its link is, in a few words."""
    fault: bool = False


def head_view(picture: HeadPicture) -> RenderableType:
    """Return the picture and its numbers, for rich to draw."""
    colour = "red" if picture.fault or picture.present_deg is None else "cyan"
    legend = Text(f"{HERE} here   {WANTED} wanted   {BOTH} there", "dim", justify="center")
    parts = Group(_field(picture), legend, *(_line(picture, axis) for axis in (0, 1)))
    return Panel(parts, title=picture.name, subtitle=picture.state, border_style=colour, expand=False)


def way(wanted_deg: Angles, present_deg: Angles) -> Angles:
    """Return how far it still is: pan the shorter way round, and tilt."""
    return math.remainder(wanted_deg[0] - present_deg[0], 360.0), wanted_deg[1] - present_deg[1]


def _field(picture: HeadPicture) -> Text:
    """Draw all that the head can look at; zero is where the lines cross."""
    marks: dict[tuple[int, int], tuple[str, str]] = {}
    zero = _cell(picture, (0.0, 0.0))
    if zero is not None:
        marks |= {(zero[0], column): ("-", "dim") for column in range(COLUMNS)}
        marks |= {(row, zero[1]): ("|", "dim") for row in range(ROWS)}
    wanted = picture.wanted_deg and _cell(picture, picture.wanted_deg)
    present = picture.present_deg and _cell(picture, picture.present_deg)
    if wanted:
        marks[wanted] = (WANTED, "bold yellow")
    if present:
        marks[present] = (BOTH, "bold green") if present == wanted else (HERE, "bold cyan")
    text = Text(no_wrap=True, overflow="crop")
    _, high_deg = picture.tilt_limits_deg
    text.append(f"{f'tilt {high_deg:+.0f} deg':^{COLUMNS}}\n", "dim")
    for row in range(ROWS):
        for column in range(COLUMNS):
            text.append(*marks.get((row, column), (".", "grey30")))
        text.append("\n")
    low_deg, _ = picture.tilt_limits_deg
    right_deg, left_deg = picture.pan_limits_deg
    left, right = f"pan {left_deg:+.0f} deg", f"pan {right_deg:+.0f} deg"
    text.append(f"{left}{f'tilt {low_deg:+.0f} deg':^{COLUMNS - len(left) - len(right)}}{right}", "dim")
    return text


def _cell(picture: HeadPicture, angles_deg: Angles) -> tuple[int, int] | None:
    """Return row and column of a direction; None where the limits leave it out."""
    shares = []
    for angle, (low, high) in zip(angles_deg, (picture.pan_limits_deg, picture.tilt_limits_deg), strict=True):
        if not low - AT_REST_DEG <= angle <= high + AT_REST_DEG:
            return None
        shares.append(min(max((high - angle) / (high - low), 0.0), 1.0) if high > low else 0.5)
    return round(shares[1] * (ROWS - 1)), round(shares[0] * (COLUMNS - 1))


def _line(picture: HeadPicture, axis: int) -> Text:
    name, forth, back = (("pan ", "left", "right"), ("tilt", "up", "down"))[axis]
    if picture.present_deg is None:
        return Text(f"{name}  unknown", "bold red")
    here = picture.present_deg[axis]
    sigma = f" +- {picture.sigma_deg[axis]:.2f}" if picture.sigma_deg else ""
    text = Text(f"{name} {here:+8.2f}{sigma} deg", "bold")
    if picture.wanted_deg is None:
        return text
    left = way(picture.wanted_deg, picture.present_deg)[axis]
    text.append(f"   wanted {picture.wanted_deg[axis]:+8.2f}   ", "yellow")
    if abs(left) <= AT_REST_DEG:
        return text.append("there", "bold green")
    return text.append(f"{abs(left):.2f} deg {forth if left > 0.0 else back}", "bold yellow")
