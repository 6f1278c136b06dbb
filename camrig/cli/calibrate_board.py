"""``camrig calibrate board``: a calibration board to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from camrig.calibrate.boards import board_word, parse_board
from camrig.cli.asked_files import check_files
from camrig.cli.console import print_json, results
from camrig.config.kept_file import replace
from camrig.errors import InputError
from camrig.report.board_sheet import Sheet, page_for, sheet_pdf, sheet_png

_SUFFIXES = (".pdf", ".png")


def board(
    word: Annotated[
        str,
        typer.Argument(
            metavar="BOARD",
            help="charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY, chessboard:COLUMNSxROWS:SQUARE_MM (inner "
            "corners), aprilgrid:COLUMNSxROWS:TAG_MM:GAP_MM, or tags:COLUMNSxROWS:TAG_MM:GAP_MM:firstID.",
        ),
    ] = "charuco:8x6:28:21:4x4_1000",
    out: Annotated[Path, typer.Option(help="The file, .pdf or .png.")] = Path("board.pdf"),
    paper: Annotated[
        str | None, typer.Option(help="a4 to a0, letter, tabloid or WIDTHxHEIGHT in mm [the smallest of A4 to A0].")
    ] = None,
    dpi: Annotated[float, typer.Option(min=30.0, max=2400.0, help="Resolution of a PNG.")] = 300.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a board to print, true to scale, with a bar to check the printer by and its word for --board.

    A ChArUco board serves best for lenses: half of it is enough in a picture. Sheets of tags bear their numbers, for
    robots and walls. Print at 100 %, measure the bar, and glue the sheet flat on something stiff.
    """
    if out.suffix.lower() not in _SUFFIXES:
        raise InputError(f"--out {out}: a board is written as {' or '.join(_SUFFIXES)}")
    check_files({"--out": out})
    labels = word.strip().lower().startswith("tags:")
    known = parse_board(word)
    sheet = Sheet(known, page_for(known, paper), labels)
    content = sheet_pdf(sheet) if out.suffix.lower() == ".pdf" else sheet_png(sheet, dpi)
    replace(out, content)
    width, height = sheet.page_mm
    if as_json:
        print_json({"file": str(out), "board": board_word(known), "page_mm": [width, height], "bar_mm": sheet.bar_mm})
        return
    results.print(f"{out}: {board_word(known)} on {width:g}x{height:g} mm", markup=False, highlight=False)
    results.print(
        f"Print at 100 %, and check that the bar is {sheet.bar_mm:g} mm long. Then calibrate with "
        f"--board {board_word(known)}",
        markup=False,
        highlight=False,
    )
