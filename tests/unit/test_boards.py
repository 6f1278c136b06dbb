"""Boards: written in a word, drawn, recognised and found to a tenth of a pixel; the traps that real ones set."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig import pictures
from camrig.calibrate.board_face import picture
from camrig.calibrate.boards import AprilGrid, Board, Charuco, Chessboard, board_word, parse_board, scaled, square_of
from camrig.calibrate.find_boards import find_board
from camrig.calibrate.recognise import recognise
from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.plugins import load_plugin

WORDS = (
    "chessboard:7x5:30",
    "charuco:8x6:30:22:4x4_1000",
    "charuco:8x6:30:22:4x4_1000:legacy",
    "charuco:4x5:54:40.5:4x4_1000:inverted",
    "charuco:5x7:30:22:apriltag_36h11",
    "aprilgrid:5x4:40:12",
    "aprilgrid:5x4:40:12:kalibr",
)


def tilted(board: Board) -> tuple[GreyImage, Array]:
    """A board as a camera without distortion sees it, a little soft, and where its points are in the picture."""
    face, to_px = picture(board, 1600.0, 0.03)
    H = np.array([[0.95, 0.08, 8.0], [-0.05, 0.97, 27.0], [3e-5, 1.5e-4, 1.0]])
    seen = cv2.warpPerspective(face, H, (face.shape[1] + 40, face.shape[0] + 40), borderValue=200)
    flat = board.points_m[:, :2] @ to_px[:, :2].T + to_px[:, 2]
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), 0.7), np.uint8), cv2.perspectiveTransform(flat[None], H)[0]


@pytest.mark.parametrize("word", WORDS)
def test_a_board_is_recognised_and_every_point_found(word: str) -> None:
    board = parse_board(word)
    image, where_px = tilted(board)
    known = recognise([image])
    assert known is not None
    assert board_word(scaled(known, square_of(board))).split(":")[:2] == word.split(":")[:2]
    if isinstance(board, Charuco):
        assert isinstance(known, Charuco)
        assert (known.dictionary, known.legacy, known.inverted) == (board.dictionary, board.legacy, board.inverted)
        assert known.marker_m == pytest.approx(board.marker_m / board.square_m, abs=0.03)
    if isinstance(board, AprilGrid):
        assert isinstance(known, AprilGrid)
        assert (known.border_bits, known.first_id) == (board.border_bits, board.first_id)
    plugin = load_plugin("detectors", "pyapriltags")
    view = find_board(image, known, plugin.make(plugin.section()))
    assert view is not None
    assert view.ids.tolist() == list(range(len(board.points_m)))
    np.testing.assert_allclose(view.corners_px, where_px, atol=0.25)
    assert np.sqrt(np.mean(np.square(view.corners_px - where_px))) < 0.1


def test_a_board_printed_through_is_read_from_behind() -> None:
    board = parse_board("charuco:4x5:54:40.5:4x4:inverted")
    image, where_px = tilted(board)
    view = find_board(np.ascontiguousarray(image[:, ::-1]), board)
    assert view is not None
    assert len(view.ids) == 12
    mirrored = np.array([image.shape[1] - 1.0, 0.0]) + np.array([-1.0, 1.0]) * where_px[view.ids]
    np.testing.assert_allclose(view.corners_px, mirrored, atol=0.25)


def test_an_aprilgrid_is_upright_for_every_detector_of_tags() -> None:
    board = AprilGrid(3, 2, 0.04, 0.012)
    image, where_px = tilted(board)
    plugin = load_plugin("detectors", "pyapriltags")
    for tag in plugin.make(plugin.section()).detect(image):
        np.testing.assert_allclose(tag.corners_px, where_px[4 * tag.key.id : 4 * tag.key.id + 4], atol=0.5)


def test_nothing_is_recognised_where_there_is_no_board() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (200, 300), dtype=np.uint8)
    assert recognise([noise, np.full((200, 300), 128, np.uint8)]) is None
    assert recognise([]) is None


def test_half_a_charuco_board_gives_the_points_that_are_there() -> None:
    board = parse_board("charuco:8x6:30:22:4x4")
    image, where_px = tilted(board)
    image[:, image.shape[1] // 2 :] = 128
    view = find_board(image, board)
    assert view is not None
    assert 8 <= len(view.ids) < 35
    np.testing.assert_allclose(view.corners_px, where_px[view.ids], atol=0.4)


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("chess:7x5:30", "write chessboard:"),
        ("chessboard:7x5", "write chessboard:"),
        ("chessboard:7by5:30", "write chessboard:"),
        ("chessboard:1x5:30", "columns and rows are 2 to 60"),
        ("charuco:8x6:30:40:4x4", "markers are smaller than squares"),
        ("charuco:8x6:30:20:9x9", "write chessboard:"),
        ("aprilgrid:30x30:30:9", "587 tags"),
        ("chessboard:7x5:0", "millimetres above 0"),
        ("aprilgrid:6x6:55:1e9", "write chessboard:"),
    ],
)
def test_a_word_that_is_no_board_is_one_sentence(word: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as error:
        parse_board(word)
    assert "\n" not in str(error.value)


@given(
    st.text(max_size=30) | st.from_regex(r"(charuco|aprilgrid|chessboard):[0-9]{1,3}x[0-9]{1,3}(:[a-z0-9_.]{1,5}){0,4}")
)
def test_any_word_is_a_board_or_one_sentence(word: str) -> None:
    try:
        board = parse_board(word)
    except InputError:
        return
    assert parse_board(board_word(board)) == board


def test_a_chessboard_of_real_pictures_is_recognised(shared_data: Path) -> None:
    paths = pictures.find(str(shared_data / "images" / "opencv_stereo_chessboard" / "left*.jpg"))[1::7]
    images = [each.image for each in pictures.read(paths) if each.image is not None]
    assert recognise(images) == Chessboard(9, 6)


def test_kalibrs_grid_of_two_bits_is_told_by_its_corners_not_by_how_many_tags_are_read(shared_data: Path) -> None:
    folder = shared_data / "images" / "aprilgrid"
    image = next(pictures.read([folder / "iphone.jpg"])).image
    assert image is not None
    board = recognise([image])
    assert isinstance(board, AprilGrid)
    assert (board.columns, board.rows, board.border_bits) == (11, 6, 2)
    assert board.gap_m == pytest.approx(0.3, abs=0.005)
    view = find_board(image, board)
    assert view is not None
    listed = json.loads((folder / "expected.json").read_text())["iphone.jpg"]["corners_opencv_convention"]
    expected = np.array([listed[str(tag)] for tag in range(66)])[:, [1, 0, 3, 2]].reshape(-1, 2)
    assert np.median(np.linalg.norm(view.corners_px - expected[view.ids], axis=-1)) < 0.5
