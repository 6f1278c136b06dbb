"""Sheets to print: true to scale to a hundredth of a millimetre, read by our own finders, refused in one sentence."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from camrig.calibrate.boards import parse_board
from camrig.calibrate.find_boards import find_board
from camrig.cli.main import build
from camrig.errors import InputError
from camrig.plugins import load_plugin
from camrig.report.board_sheet import Sheet, page_for, sheet_pdf, sheet_png

WORDS = ("chessboard:7x5:30", "charuco:8x6:30:22:4x4_1000", "aprilgrid:4x5:40:12", "aprilgrid:4x5:40:12:kalibr")
DPI = 127.0
PX_PER_MM = DPI / 25.4


def png(word: str) -> tuple[Sheet, bytes]:
    board = parse_board(word)
    sheet = Sheet(board, page_for(board, None))
    return sheet, sheet_png(sheet, DPI)


@pytest.mark.parametrize("word", WORDS)
def test_a_png_is_true_to_scale(word: str) -> None:
    sheet, data = png(word)
    assert struct.unpack(">IIB", data[data.index(b"pHYs") + 4 :][:9]) == (5000, 5000, 1)
    page = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    assert page.shape == tuple(round(side * PX_PER_MM) for side in sheet.page_mm[::-1])
    plugin = load_plugin("detectors", "pyapriltags")
    view = find_board(np.asarray(page, np.uint8), sheet.board, plugin.make(plugin.section()))
    assert view is not None
    assert len(view.ids) == len(sheet.board.points_m)
    points_mm, seen_mm = 1000.0 * sheet.board.points_m[:, :2], view.corners_px / PX_PER_MM
    assert np.ptp(seen_mm, axis=0) == pytest.approx(np.ptp(points_mm, axis=0), abs=0.1)


@pytest.mark.parametrize("word", WORDS)
def test_a_pdf_has_the_board_and_a_bar_in_points(word: str) -> None:
    board = parse_board(word)
    sheet = Sheet(board, page_for(board, "a3"))
    data = sheet_pdf(sheet)
    box = re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data)
    assert box is not None
    assert [float(side) / 72.0 * 25.4 for side in box.groups()] == pytest.approx(sheet.page_mm, abs=0.01)
    assert b"/PrintScaling /None" in data
    content = zlib.decompress(data[data.index(b"stream\n") + 7 : data.index(b"\nendstream")]).decode("latin-1")
    drawn = np.array([line.split()[:4] for line in content.splitlines() if line.endswith(" re")], float) / 72.0 * 25.4
    np.testing.assert_allclose(drawn[:, 2:], sheet.rectangles_mm()[:, 2:], atol=0.01)
    assert drawn[:, 2].max() == pytest.approx(100.0, abs=0.01)
    assert f"camrig board  {word}" in content
    assert int(data.split(b"startxref\n")[1].split(b"\n")[0]) == data.index(b"xref\n0")


def test_a_board_and_its_words_stay_on_the_page_and_apart() -> None:
    for word in WORDS:
        board = parse_board(word)
        sheet = Sheet(board, page_for(board, None))
        rectangles = sheet.rectangles_mm()
        assert (rectangles[:, :2] >= 0.0).all()
        assert (rectangles[:, :2] + rectangles[:, 2:] <= np.array(sheet.page_mm)).all()
        bar = 12  # ticks and line come last
        assert (rectangles[:-bar, 1] + rectangles[:-bar, 3]).max() < min(y - size for _, y, size, _ in sheet.texts())


def test_tags_bear_their_numbers(tmp_path: Path) -> None:
    out = tmp_path / "tags.pdf"
    build(("calibrate",))(["calibrate", "board", "tags:2x3:60:20:first100", "--out", str(out)], standalone_mode=False)
    data = out.read_bytes()
    content = zlib.decompress(data[data.index(b"stream\n") + 7 : data.index(b"\nendstream")]).decode("latin-1")
    assert all(f"({number}   60 mm)" in content for number in range(100, 106))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("charuco:8x6:30:22:4x4", "--paper", "b5"), "--paper is one of a4"),
        (("charuco:8x6:60:44:4x4", "--paper", "a4"), "does not fit on --paper a4"),
        (("charuco:40x30:60:44:4x4",), "does not fit on A0"),
        (("chessboard:7x5:30", "--out", "board.docx"), "is written as .pdf or .png"),
        (
            ("chessboard:7x5:30", "--out", "nowhere/board.pdf"),
            "--out: nowhere/board.pdf cannot be written: there is no folder",
        ),
        (("circles:7x5:30",), "write chessboard:.* or tags:COLUMNSxROWS"),
        (("tags:2x2:50:10:first99999",), "board 'tags:2x2:50:10:first99999': tag36h11 has"),
    ],
)
def test_what_cannot_be_printed_is_one_sentence(arguments: tuple[str, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        build(("calibrate",))(["calibrate", "board", *arguments], standalone_mode=False)
