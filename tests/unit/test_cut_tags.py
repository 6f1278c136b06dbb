"""Tags that the picture's edge cuts: the detector guesses their corners, so they place nothing."""

from __future__ import annotations

import numpy as np
import pytest

from camrig.locate.tags import TagOwner, undistorted
from camrig.messages import TagDetection
from camrig.rig import TagKey
from tests.anchored_cameras import LENS

SQUARE_PX = np.array([[0.0, 80.0], [80.0, 80.0], [80.0, 0.0], [0.0, 0.0]])
OWNER = TagOwner("robot", np.eye(4), 0.2)
ALL, NONE = (True,) * 4, (False,) * 4


@pytest.mark.parametrize(
    ("left_px", "top_px", "refined", "used"),
    [
        (600.0, 300.0, NONE, True),
        (600.0, 12.0, NONE, True),  # a rim of one cell and more
        (600.0, 5.0, ALL, True),  # its edges were followed: where they meet is known
        (600.0, 5.0, (True, True, True, False), False),
        (600.0, 634.0, NONE, False),
        (1196.0, 300.0, (False, True, True, True), True),  # the corner that is guessed lies far inside
        (1196.0, 300.0, (True, False, True, True), False),
        (-1.0, 300.0, ALL, False),
    ],
)
def test_a_tag_is_used_unless_the_edge_cuts_it(
    left_px: float, top_px: float, refined: tuple[bool, bool, bool, bool], used: bool
) -> None:
    corners_px = SQUARE_PX + np.array([left_px, top_px])
    x, y = corners_px.mean(axis=0)
    tag = TagDetection(TagKey("tag36h11", 1), corners_px, (float(x), float(y)), 0, 60.0, refined)
    assert bool(undistorted(LENS, [(tag, OWNER)])) is used
