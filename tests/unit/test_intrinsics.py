"""A lens from points of a board: formulas, honest sigmas, forms by evidence, and every trap ends in words."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camrig.calibrate.boards import Board, BoardView, Charuco, Chessboard
from camrig.calibrate.intrinsics import Intrinsics, Kind, calibrate_lens, steps
from camrig.calibrate.lens_evidence import difference_px
from camrig.calibrate.lens_fit import fit_lens, points_of
from camrig.calibrate.lens_forms import FISHEYE_LADDER, LADDER, LensForm, pixel_slopes, sensor_of
from camrig.calibrate.shots import Shot, gauges, next_pose
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens, Lens
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_x, rotation_y, rotation_z

BOARD = Chessboard(9, 6, 0.03)
LENS = BrownLens((640, 480), (540.0, 541.0), (325.0, 236.0), (-0.28, 0.09, 0.0008, -0.0005))
FISHEYE = FisheyeLens((640, 480), (210.0, 210.5), (322.0, 238.0), (0.02, -0.005, 0.001, 0.0))
WIDE_BOARD = Chessboard(9, 6, 0.06)


def poses(count: int, board: Board, lens: Lens, *, tilt_rad: float = 0.7, seed: int = 0) -> list[Transform]:
    """Poses all over the picture, near and far, tilted to all sides."""
    random = np.random.default_rng(seed)
    middle = np.append(board.points_m[:, :2].mean(axis=0), 0.0)
    length = float(np.ptp(board.points_m[:, 0]))
    found = []
    for index in range(count):
        side = 2.4 * index
        R = rotation_x(tilt_rad * math.sin(side)) @ rotation_y(tilt_rad * math.cos(side))
        R = R @ rotation_z(0.2 * random.standard_normal())
        share = 0.2 + 0.6 * np.array([(0.618 * index) % 1.0, (0.755 * index) % 1.0])
        a, b = lens.unproject(share * np.asarray(lens.size_px))
        depth = length * lens.focal_px[0] / lens.size_px[0] * (1.2 + random.random())
        found.append(transform(R, depth * np.array([a, b, 1.0]) - R @ middle))
    return found


def shots(
    lens: Lens, board: Board, places: list[Transform], noise_px: float = 0.15, seed: int = 3, edge_px: float = 2.0
) -> list[Shot]:
    """What pictures show: points within the picture, with noise."""
    random = np.random.default_rng(seed)
    found = []
    for index, T in enumerate(places):
        pixels = lens.project(board.points_m @ T[:3, :3].T + T[:3, 3])
        inside = np.isfinite(pixels).all(axis=-1) & ((pixels > 2) & (pixels < np.asarray(lens.size_px) - 3)).all(
            axis=-1
        )
        noisy = pixels[inside] + random.normal(0.0, noise_px, (int(inside.sum()), 2))
        found.append(Shot(f"{index:02d}.png", BoardView(np.flatnonzero(inside), noisy), edge_px))
    return found


def calibrated(lens: Lens, board: Board = BOARD, count: int = 16, kind: Kind = Kind.AUTO) -> Intrinsics:
    return calibrate_lens(shots(lens, board, poses(count, board, lens)), board, lens.size_px, kind)


@pytest.mark.parametrize("form", [LADDER[0], LADDER[-1], FISHEYE_LADDER[-1]], ids=lambda form: form.name)
def test_slopes_of_every_number_are_those_of_the_formula(form: LensForm) -> None:
    random = np.random.default_rng(1)
    numbers = np.concatenate([[500.0, 510.0, 320.0, 240.0], random.normal(0.0, 0.05, form.size - 4)])
    ideal = random.uniform(-0.8, 0.8, (20, 2))

    def pixel(at: Array) -> Array:
        return sensor_of(form, at, ideal) * at[:2] + at[2:4]

    slopes = pixel_slopes(form, numbers, ideal)
    for index in range(form.size):
        step = np.zeros(form.size)
        step[index] = 1e-6 * max(1.0, abs(numbers[index]))
        numeric = (pixel(numbers + step) - pixel(numbers - step)) / (2.0 * step[index])
        np.testing.assert_allclose(slopes[..., index], numeric, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("lens", "board", "right"),
    [
        (LENS, BOARD, {"k1 k2 p1 p2"}),
        (BrownLens((640, 480), (700.0, 700.0), (318.0, 241.0)), BOARD, {"square pixels k1"}),
        (FISHEYE, WIDE_BOARD, {"fisheye k1 k2", "fisheye k1 k2 k3 k4"}),
    ],
    ids=["brown", "without bend", "fisheye"],
)
def test_the_right_form_is_chosen_and_the_lens_is_right_to_its_own_word(
    lens: Lens, board: Board, right: set[str]
) -> None:
    found = calibrated(lens, board, count=14)
    assert found.fit.form.name in right
    apart = difference_px(found.lens, lens)
    assert apart is not None
    assert apart["median"] < 0.3
    for value, truth, sigma in zip(
        (*found.lens.focal_px, *found.lens.centre_px),
        (*lens.focal_px, *lens.centre_px),
        (found.sigma[name] for name in ("fx", "fy", "cx", "cy")),
        strict=True,
    ):
        assert abs(value - truth) < 4.0 * sigma
    assert found.chosen.heldout_rms_px < 1.15 * found.fit.rms_px
    assert not [concern for concern in found.concerns if concern.severe]


def test_sigmas_are_as_large_as_errors_are() -> None:
    places = poses(14, BOARD, LENS)
    form, misses, fit = LADDER[3], [], None
    for seed in range(16):
        views = [(BOARD.points_m[s.view.ids], s.view.corners_px) for s in shots(LENS, BOARD, places, seed=seed)]
        fit = fit_lens(points_of(LENS.size_px, views), form, fit)
        sigma = np.sqrt(np.diag(fit.covariance)[:4])
        misses.append((fit.numbers[:4] - [*LENS.focal_px, *LENS.centre_px]) / sigma)
    spread = np.sqrt(np.mean(np.square(misses)))
    assert 0.75 < spread < 1.3


def test_many_coefficients_are_not_taken_for_few_pictures_of_the_middle() -> None:
    small = Chessboard(7, 5, 0.012)
    lens = BrownLens((640, 480), (540.0, 540.0), (322.0, 238.0), (-0.2, 0.05, 0.0, 0.0))
    centre = [
        transform(T[:3, :3], np.array([0.02 * (i % 3), 0.02 * (i % 2), 0.35]))
        for i, T in enumerate(poses(12, small, lens))
    ]
    found = calibrate_lens(shots(lens, small, centre), small, lens.size_px, Kind.BROWN)
    assert len(found.fit.form.free) <= 4
    assert found.lens.r_max < 0.6
    assert any("hold it in every corner" in concern.text for concern in found.concerns)


def test_a_board_of_twelve_corners_says_not_enough_data() -> None:
    board = Charuco(4, 5, 0.054, 0.0405)
    found = calibrate_lens(
        shots(LENS, board, poses(10, board, LENS, tilt_rad=0.35), noise_px=0.4), board, LENS.size_px, Kind.BROWN
    )
    assert any("not enough data" in concern.text for concern in found.concerns)


def test_bad_pictures_are_set_aside_by_name_and_the_rest_counts() -> None:
    good = shots(LENS, BOARD, poses(14, BOARD, LENS))
    wrong = shots(LENS, BOARD, poses(1, BOARD, LENS, seed=9), noise_px=4.0, seed=8)[0].view
    blurred = shots(LENS, BOARD, poses(3, BOARD, LENS, seed=7), edge_px=9.0)[2].view
    taken = [
        *good,
        Shot("bent.png", wrong, 2.0),
        Shot("soft.png", blurred, 9.0),
        Shot("again.png", BoardView(good[3].view.ids, good[3].view.corners_px + 0.5), 2.0),
        Shot("hand.png", BoardView(good[5].view.ids[:5], good[5].view.corners_px[:5]), 2.0),
    ]
    found = calibrate_lens(taken, BOARD, LENS.size_px, Kind.FISHEYE)
    assert set(found.rejected) == {"bent.png", "soft.png", "again.png", "hand.png"}
    assert "points miss by" in found.rejected["bent.png"]
    assert "blurred" in found.rejected["soft.png"]
    assert "repeats 03.png" in found.rejected["again.png"]
    assert "shows 5 points" in found.rejected["hand.png"]
    assert found.fit.rms_px < 0.25


def test_a_board_that_always_faces_the_camera_is_refused() -> None:
    facing = [transform(np.eye(3), T[:3, 3]) for T in poses(12, BOARD, LENS)]
    with pytest.raises(InputError, match="faces the same way in all pictures"):
        calibrate_lens(shots(LENS, BOARD, facing), BOARD, LENS.size_px)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_pictures_are_refused(count: int) -> None:
    with pytest.raises(InputError, match="too few: take 10 or more"):
        calibrate_lens(shots(LENS, BOARD, poses(count, BOARD, LENS)), BOARD, LENS.size_px)


def test_r_max_is_where_the_lens_is_known_and_every_form_is_counted() -> None:
    ticks: list[int] = []
    taken = shots(LENS, BOARD, poses(10, BOARD, LENS))
    found = calibrate_lens(taken, BOARD, LENS.size_px, Kind.BROWN, lambda: ticks.append(1))
    assert len(ticks) == steps(Kind.BROWN) == len(LADDER)
    corners = LENS.unproject(np.array([[0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0]]))
    farthest = float(np.linalg.norm(corners, axis=-1).max())
    assert 0.6 * farthest < found.lens.r_max <= 1.05 * farthest


def test_the_next_pose_is_where_and_how_the_board_was_not() -> None:
    taken = [shot.view for shot in shots(LENS, BOARD, poses(16, BOARD, LENS))]
    left = [view for view in taken if view.corners_px[:, 0].max() < 400.0]
    assert "right" in next_pose(left, BOARD, LENS.size_px)
    assert next_pose([], BOARD, LENS.size_px) == "hold the board in the middle, facing the camera"
    measured = gauges(taken, BOARD, LENS.size_px)
    assert measured.coverage > gauges(left, BOARD, LENS.size_px).coverage
    assert measured.sides == 4
