"""Puts labels beside what they name, so that they cover neither each other nor a mark. Imports matplotlib."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from camrig.geometry.arrays import Array
from camrig.report.plan_axes import CROWD, Word, Words

_MARK_PX = 15.0
_DISTANCES_PX = (18.0, 28.0, 44.0, 64.0)
_DIRECTIONS = [math.radians(degrees) for degrees in (0, 180, 90, 270, 45, 135, 225, 315)]
_HALO = [withStroke(linewidth=2.5, foreground="white")]


def place_labels(axes: Axes, words: Words) -> None:
    """Draw the labels; the axes must have been laid out."""
    crowded = sum(word.is_target for word in words.labels) > CROWD
    labels = (words.without_targets() if crowded else words).labels
    marks = axes.transData.transform(np.array(words.marks))
    taken = [np.concatenate([mark - _MARK_PX, mark + _MARK_PX]) for mark in marks]
    frame = np.array(axes.bbox.extents)
    for word in labels:
        taken.append(_place(axes, word, np.array(taken), frame))


def _place(axes: Axes, word: Word, taken: Array, frame: Array) -> Array:
    """Draw a label at the first best of the places about its mark; returns the (4,) pixels of its box."""
    at = axes.transData.transform(np.array(word.at))
    weight = "normal" if word.is_target else "bold"
    text = axes.text(0, 0, word.text, fontsize=8, fontweight=weight, color=word.colour, path_effects=_HALO, zorder=6)
    box = np.array(text.get_window_extent().extents)
    size = box[2:] - box[:2]
    boxes = [_box(at, distance, angle, size) for distance in _DISTANCES_PX for angle in _DIRECTIONS]
    costs = [_overlap(box, taken) + 10.0 * _outside(box, frame) for box in boxes]
    best = int(np.argmin(costs))
    box = boxes[best]
    inverse = axes.transData.inverted()
    text.set_position(tuple(inverse.transform(box[:2])))
    if best >= len(_DIRECTIONS):
        middle = inverse.transform((box[:2] + box[2:]) / 2.0)
        axes.plot([word.at[0], middle[0]], [word.at[1], middle[1]], color=word.colour, linewidth=0.5, zorder=5.5)
    return box


def _box(at: Array, distance: float, angle: float, size: Array) -> Array:
    """Return the (4,) pixels of a box of a size whose nearest edge lies about ``distance`` from a mark."""
    towards = np.array([math.cos(angle), math.sin(angle)])
    centre = at + towards * (distance + size / 2.0 * (np.abs(towards) > 0.1))
    return np.concatenate([centre - size / 2.0, centre + size / 2.0])


def _overlap(box: Array, others: Array) -> float:
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    return float(np.prod(np.maximum(sides, 0.0), axis=1).sum())


def _outside(box: Array, frame: Array) -> float:
    return float(np.maximum(frame[:2] - box[:2], 0.0).sum() + np.maximum(box[2:] - frame[2:], 0.0).sum())
