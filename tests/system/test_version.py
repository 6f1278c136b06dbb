"""``camrig --version``: what an operator is asked for first."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest

from camrig.cli.main import main

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def test_the_version_is_the_projects(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["camrig", "--version"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert not caught.value.code
    assert capsys.readouterr() == (f"camrig {tomllib.loads(PROJECT.read_text())['project']['version']}\n", "")
