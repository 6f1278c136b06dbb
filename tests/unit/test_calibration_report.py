"""The page of a calibration: self-contained, escaped, whole or not at all, and readable without matplotlib."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from camrig.cli.asked_files import write_report
from camrig.errors import InputError
from camrig.messages import Verdict
from camrig.report.calibration import (
    WITHOUT_FIGURES,
    CalibrationReport,
    Drawing,
    Table,
    report_html,
)

pytestmark = pytest.mark.usefixtures("picture_fonts")


def line(figure: Any) -> None:
    figure.subplots().plot([0, 1], [0, 2])


REPORT = CalibrationReport(
    title="Lens of <north>",
    verdict=Verdict.AMBER,
    reasons=("held-out residual is 1.4 x that of training",),
    facts={"rms": "0.17 px"},
    sections=(Table("Shots", ("picture", "rms"), (("a&b.png", "0.2"),)), Drawing("Residuals", line, (3.0, 2.0), "px")),
)


def test_a_page_is_well_formed_and_holds_everything() -> None:
    page = report_html(REPORT)
    tree = ET.fromstring(
        page.split("\n", 1)[1]
        .replace('<meta charset="utf-8">', "")
        .replace('<meta name="viewport" content="width=device-width, initial-scale=1">', "")
    )
    text = " ".join(tree.itertext())
    for word in ("Lens of <north>", "amber", "held-out residual", "0.17 px", "a&b.png", "Residuals"):
        assert word in text
    assert len(tree.findall(".//{http://www.w3.org/2000/svg}svg")) == 1
    assert "http" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    ).replace("https://matplotlib.org", "")


def test_a_page_without_matplotlib_says_how_to_get_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "camrig.report.canvas", None)
    page = report_html(REPORT)
    assert WITHOUT_FIGURES.replace("'", "&#x27;") in page
    assert "<svg" not in page
    assert "0.17 px" in page


def test_a_page_is_written_whole_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "lens.html"
    path.write_text("old")
    write_report(path, REPORT)
    assert path.read_text(encoding="utf-8") == report_html(REPORT)
    assert [file.name for file in tmp_path.iterdir()] == ["lens.html"]


def test_a_page_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written: there is no folder"):
        write_report(tmp_path / "missing" / "lens.html", REPORT)
