"""Files of lenses: one lens is put in, the others and what people wrote stay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from camrig.config.lens_book import check_place, put_lens
from camrig.errors import InputError

ENTRY: dict[str, Any] = {
    "model": "brown", "size_px": [640, 480], "fx": 500.0, "fy": 501.0, "cx": 319.0, "cy": 239.0,
    "distortion": [-0.1, 0.02], "r_max": 0.9,
}  # fmt: skip
THERE = """\
lenses:
  west: {model: brown, size_px: [640, 480], fx: 400, fy: 400, cx: 320, cy: 240, readout_s: 0.01}  # the old one
  tele:
    model: brown
    size_px: [640, 480]
    zoom:
    - {position: 0, fx: 500, fy: 500}
    - {position: 100, fx: 900, fy: 900}
"""


@pytest.fixture
def book(tmp_path: Path) -> Path:
    path = tmp_path / "lenses.yaml"
    path.write_text(THERE)
    return path


def test_a_lens_is_put_beside_the_others(book: Path) -> None:
    assert put_lens(book, "east", ENTRY) == ""
    assert put_lens(book, "west", ENTRY) == ""
    assert "# the old one" in book.read_text()
    assert yaml.safe_load(book.read_text())["lenses"] == {
        "west": {**ENTRY, "readout_s": 0.01},
        "tele": yaml.safe_load(THERE)["lenses"]["tele"],
        "east": ENTRY,
    }


def test_a_lens_of_another_kind_is_told(book: Path) -> None:
    assert put_lens(book, "west", {**ENTRY, "model": "fisheye"}) == "brown lens for 640x480 px"


def test_a_row_of_zoom_is_put_among_the_others(book: Path) -> None:
    put_lens(book, "tele", ENTRY, zoom_position=50)
    lenses = yaml.safe_load(book.read_text())["lenses"]
    assert [(row["position"], row["fx"]) for row in lenses["tele"]["zoom"]] == [(0, 500), (50, 500.0), (100, 900)]
    assert lenses["west"]["fx"] == 400
    with pytest.raises(InputError, match="they cannot be one"):
        put_lens(book, "tele", {**ENTRY, "model": "fisheye"}, zoom_position=50)


@pytest.mark.parametrize(
    ("text", "name", "zoom", "says"),
    [
        (THERE, "tele", False, "has a table of zoom: give --zoom-position"),
        (THERE, "west", True, "has one focal length"),
        ("lenses: [1]\n", "west", True, "is no file of lenses"),
        ("lenses: {west: 3}\n", "west", False, "is no file of lenses"),
        ("lenses: {west: {zoom: [3]}}\n", "west", True, "zoom is a list of rows"),
        ("lenses: {west: {zoom: 3}}\n", "west", True, "zoom is a list of rows"),
        ("- 1\n", "west", True, "must hold a mapping"),
    ],
)
def test_a_file_that_cannot_take_it_is_refused_before(
    tmp_path: Path, text: str, name: str, zoom: bool, says: str
) -> None:
    path = tmp_path / "lenses.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        check_place(path, name, zoom=zoom)
