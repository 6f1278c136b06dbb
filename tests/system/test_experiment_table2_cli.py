"""What ``camrig experiment table2`` refuses before anything moves."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from camrig.cli.main import main
from tests.daemon_on_fakes import RIG

SURVEYED = "id,x_m,y_m,z_m\nrobot1,1,2,0\n"


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--rig", "rig.yaml"], "--rig and --truth go together"),
        (["--truth", "truth.csv"], "--rig and --truth go together"),
        (["--methods", "magic"], "not 'magic'"),
        (["--rig", "rig.yaml", "--truth", "truth.csv"], "nothing was moved: --yes says that the heads pt1, pt2 may be"),
        (["--rig", "rig.yaml", "--truth", "rig.yaml"], "the first line names the columns"),
        (["--rig", "none.yaml", "--truth", "truth.csv"], "none.yaml"),
    ],
)
def test_what_cannot_be_done_is_refused(
    flags: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "truth.csv").write_text(SURVEYED)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["camrig", "experiment", "table2", *flags])
    with pytest.raises(SystemExit) as caught:
        main()
    said = capsys.readouterr()
    assert (caught.value.code, said.out) == (2, "")
    assert words in said.err
    assert "Traceback" not in said.err
