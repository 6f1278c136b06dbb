"""A calibration board on paper, true to scale: PDF with vectors, or PNG with its resolution written in.

On the sheet stand the board's word, by which every command knows it, and a bar to check the printer with. The PDF is
written here, rectangles and lines of text; PDF 1.4 (ISO 32000-1, sections 7.5 and 8.5) needs nothing more of it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from camrig.calibrate.board_face import black, extent
from camrig.calibrate.boards import AprilGrid, Board, board_word
from camrig.errors import InputError
from camrig.geometry.arrays import Array

PAPERS_MM = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
_MARGIN_MM = 8.0
_FOOT_MM = 22.0
_TEXT_MM = 3.2
_LABEL_MM = 3.0
_TICK_MM = 10.0
_BARS_MM = (100.0, 50.0)
_PT_PER_MM = 72.0 / 25.4
_MOST_PIXELS = 400_000_000


@dataclass(frozen=True)
class Sheet:
    """A board on a page of (width, height) ``page_mm``; ``labels``: each tag's number below it."""

    board: Board
    page_mm: tuple[float, float]
    labels: bool = False

    @property
    def bar_mm(self) -> float:
        """Return how long the bar is."""
        return next((length for length in _BARS_MM if length <= self.page_mm[0] - 2.0 * _MARGIN_MM), _TICK_MM)

    def rectangles_mm(self) -> Array:
        """Return (n, 4) black rectangles x, y, width, height, from the top left of the page: the board, the bar."""
        inked = 1000.0 * black(self.board)
        origin, up = self._origin()
        x = origin[0] + inked[:, 0]
        y = origin[1] - inked[:, 3] if up else origin[1] + inked[:, 1]
        board = np.stack([x, y, inked[:, 2] - inked[:, 0], inked[:, 3] - inked[:, 1]], axis=-1)
        return np.concatenate([board, np.array(list(self._bar()))])

    def texts(self) -> Iterator[tuple[float, float, float, str]]:
        """Yield x, y of the baseline and size in millimetres, and the text."""
        foot = self.page_mm[1] - _MARGIN_MM
        yield _MARGIN_MM, foot - 12.0, _TEXT_MM, f"camrig board  {board_word(self.board)}"
        yield _MARGIN_MM + self.bar_mm + 3.0, foot - 5.2, _TEXT_MM, f"{self.bar_mm:g} mm"
        yield _MARGIN_MM, foot, _TEXT_MM * 0.85, "Print at 100 %, measure the bar, glue it flat on something stiff."
        if self.labels and isinstance(self.board, AprilGrid):
            yield from self._labels(self.board)

    def _origin(self) -> tuple[tuple[float, float], bool]:
        """Return where on the page the board's origin is, and whether its y goes up."""
        x0, y0, x1, y1 = (1000.0 * value for value in extent(self.board))
        width, height = self.page_mm
        left, top = 0.5 * (width - (x1 - x0)), 0.5 * (height - _FOOT_MM - (y1 - y0))
        up = isinstance(self.board, AprilGrid)
        return (left - x0, top + y1 if up else top - y0), up

    def _bar(self) -> Iterator[tuple[float, float, float, float]]:
        y = self.page_mm[1] - _MARGIN_MM - 6.0
        yield _MARGIN_MM, y, self.bar_mm, 0.3
        for tick in np.arange(0.0, self.bar_mm + 0.1, _TICK_MM):
            yield _MARGIN_MM + tick - 0.1, y - 3.0, 0.2, 3.0

    def _labels(self, board: AprilGrid) -> Iterator[tuple[float, float, float, str]]:
        (x, y), _ = self._origin()
        pitch = 1000.0 * (board.tag_m + board.gap_m)
        for number in range(board.columns * board.rows):
            row, column = divmod(number, board.columns)
            text = f"{board.first_id + number}   {1000.0 * board.tag_m:g} mm"
            yield x + column * pitch, y - row * pitch + _LABEL_MM + 2.0, _LABEL_MM, text


def page_for(board: Board, paper: str | None) -> tuple[float, float]:
    """Return the page in millimetres: of a named paper or WIDTHxHEIGHT, turned as the board lies; without a name the
    smallest A4 to A0 that it fits on. Raises InputError where it does not fit.
    """
    x0, y0, x1, y1 = (1000.0 * value for value in extent(board))
    need = (x1 - x0 + 2.0 * _MARGIN_MM, y1 - y0 + 2.0 * _MARGIN_MM + _FOOT_MM)
    named = [_paper(paper)] if paper else [PAPERS_MM[name] for name in ("a4", "a3", "a2", "a1", "a0")]
    for page in named:
        for width, height in (page, page[::-1]):
            if need[0] <= width and need[1] <= height:
                return width, height
    where = f"--paper {paper}" if paper else "A0"
    raise InputError(
        f"board {board_word(board)} needs {need[0]:.0f}x{need[1]:.0f} mm with its margin and does not fit on {where}"
    )


def _paper(name: str) -> tuple[float, float]:
    if name.lower() in PAPERS_MM:
        return PAPERS_MM[name.lower()]
    try:
        width, height = (float(part) for part in name.lower().split("x"))
    except ValueError:
        width = height = 0.0
    if not (20.0 <= width <= 5000.0 and 20.0 <= height <= 5000.0):
        raise InputError(f"--paper is one of {', '.join(PAPERS_MM)} or WIDTHxHEIGHT in mm, not '{name}'")
    return width, height


def sheet_pdf(sheet: Sheet) -> bytes:
    """Return the sheet as PDF."""
    height = sheet.page_mm[1]
    content = ["0 g"]
    content += [
        f"{x * _PT_PER_MM:.4f} {(height - y - h) * _PT_PER_MM:.4f} {w * _PT_PER_MM:.4f} {h * _PT_PER_MM:.4f} re"
        for x, y, w, h in sheet.rectangles_mm()
    ]
    content.append("f")
    for x, y, size, text in sheet.texts():
        escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        place = f"{x * _PT_PER_MM:.2f} {(height - y) * _PT_PER_MM:.2f} Td"
        content.append(f"BT /F1 {size * _PT_PER_MM:.2f} Tf {place} ({escaped}) Tj ET")
    stream = zlib.compress("\n".join(content).encode("latin-1"), 9)
    box = " ".join(f"{side * _PT_PER_MM:.4f}" for side in sheet.page_mm)
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d /Filter /FlateDecode >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    offsets = []
    for number, each in enumerate(objects, 1):
        offsets.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, each)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    out += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)


def sheet_png(sheet: Sheet, dpi: float) -> bytes:
    """Return the sheet as PNG that says its resolution. Raises InputError where that is too many pixels."""
    scale = dpi / 25.4
    width, height = (round(side * scale) for side in sheet.page_mm)
    if width * height > _MOST_PIXELS:
        raise InputError(f"{width}x{height} pixels are too many: take a lower --dpi, or PDF")
    page = np.full((height, width), 255, np.uint8)
    for x, y, w, h in sheet.rectangles_mm() * scale:
        page[round(y) : max(round(y + h), round(y) + 1), round(x) : max(round(x + w), round(x) + 1)] = 0
    for x, y, size, text in sheet.texts():
        (_, drawn), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)
        factor, thickness = 0.72 * size * scale / drawn, max(1, round(0.09 * size * scale))
        place = (round(x * scale), round(y * scale))
        cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, factor, 0, thickness, cv2.LINE_AA)
    return _with_resolution(cv2.imencode(".png", page)[1].tobytes(), scale)


def _with_resolution(png: bytes, px_per_mm: float) -> bytes:
    """Put a pHYs chunk after the header. Source: PNG specification, 11.3.4.3."""
    per_m = round(1000.0 * px_per_mm)
    body = b"pHYs" + struct.pack(">IIB", per_m, per_m, 1)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:33] + chunk + png[33:]
