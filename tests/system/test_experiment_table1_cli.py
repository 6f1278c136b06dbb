"""``camrig experiment table1`` as its users meet it: made by two processes, gone on with, the same again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from camrig.cli.main import main

QUICK = ("--quick", "--no-figures", "--conditions", "anchored", "--seed", "3")


def table1(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A program of its own: how many threads linear algebra has is settled when one starts."""
    command = [sys.executable, "-m", "camrig", "experiment", "table1", *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=240.0, env=environment, check=False)


def test_a_quick_table_is_the_same_whoever_makes_it_and_however_often(tmp_path: Path) -> None:
    made = table1(*QUICK, "--jobs", "2", "--out", str(tmp_path))
    assert (made.returncode, made.stdout) == (0, ""), made.stderr
    first = json.loads((tmp_path / "table1.json").read_text())
    assert [(duel["mode"], duel["condition"]) for duel in first["duels"]] == [
        ("ptz", "anchored"),
        ("drone", "anchored"),
    ]
    assert all(duel["coverage"] == 1.0 and duel["detected"]["ratio"]["value"] < 1.0 for duel in first["duels"])
    assert "| drone 3, 3 | anchored |" in (tmp_path / "table1.md").read_text()

    kept = tmp_path / "table1.jsonl"
    head, *lines = kept.read_text().splitlines(keepends=True)
    kept.write_text(head + "".join(line for line in lines if '"ptz 3x3 3' not in line))
    again = table1(*QUICK, "--jobs", "1", "--out", str(tmp_path), "--json")
    assert again.returncode == 0, again.stderr
    assert "1 of 2 parts were done before" in again.stderr
    second = json.loads(again.stdout)
    for differing in ("times", "machine"):
        del first[differing], second[differing]
    assert first == second


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--sizes", "3"], "as in 3x3,5x10, not '3'"),
        (["--conditions", "perfect"], "--conditions takes exact or off or anchored, not 'perfect'"),
        (["--configurations", "magic"], "not 'magic'"),
        (["--out", "/dev/null"], "--out takes a folder"),
        (["--jobs", "-1"], "--jobs"),
    ],
)
def test_what_cannot_be_done_is_refused(
    flags: list[str], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["camrig", "experiment", "table1", *flags])
    with pytest.raises(SystemExit) as caught:
        main()
    said = capsys.readouterr()
    assert (caught.value.code, said.out) == (2, "")
    assert words in said.err
