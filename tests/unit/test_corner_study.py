"""The study of corners by width and place: what docs/accuracy.md promises, on many pictures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from camrig.geometry.corner_noise import refined_sigma_px
from tests.corner_study import RADII, WIDTHS_PX, errors, in_bin, rms, seen_tags, table

FEWEST = 8
"""Tags that a bin must hold to be judged."""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_refined_corners_are_as_good_as_promised_in_every_bin_and_nowhere_worse_than_the_detectors() -> None:
    seen = list(seen_tags(800, seed=2))
    judged = 0
    for widths in pairwise(WIDTHS_PX):
        for place in pairwise(RADII):
            detected, published, _ = errors(in_bin(seen, widths, place))
            if len(detected) < FEWEST:
                continue
            judged += 1
            # Four corners of two coordinates each: a root mean square of 8 tags is known to a tenth.
            assert rms(published) < 1.1 * rms(detected), (widths, place)
            if widths[0] >= 25.0:
                assert rms(published) < (0.035 if widths[0] < 40.0 else 0.02) * 1.1, (widths, place)
    assert judged > 20
    _, published, refined = errors(seen)
    widths_px = np.array([tag.width_px for tag in seen])[:, None, None]
    whitened = (published / refined_sigma_px(widths_px))[refined]
    assert 0.75 < rms(whitened) < 1.05


def test_a_few_tags_make_a_table() -> None:
    lines = table(list(seen_tags(4, seed=0))).splitlines()
    assert len(lines) == 2 + len(WIDTHS_PX) - 1
    assert len({line.count("|") for line in lines}) == 1
