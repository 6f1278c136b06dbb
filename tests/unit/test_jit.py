"""Machine code that is kept for the next start, and thrown away when any source it may hold has changed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from camrig.geometry.jit import forget_outdated


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package with a kernel that calls another file's function, both written at 100 s."""
    for name in ("geometry/pose.py", "sensing/point.py", "optimise/kernels/compass.py"):
        written(tmp_path / name, 100.0)
    return tmp_path


def written(path: Path, stamp_s: float) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    os.utime(path, (stamp_s, stamp_s))
    return path


def test_code_as_new_as_every_source_is_kept(package: Path) -> None:
    kept = written(package / "optimise/kernels/__pycache__/compass.descend-3.py311.nbi", 101.0)
    assert forget_outdated(package)
    assert kept.exists()


def test_code_older_than_another_files_source_is_not(package: Path) -> None:
    kept = written(package / "optimise/kernels/__pycache__/compass.descend-3.py311.1.nbc", 101.0)
    told = written(package / "elsewhere/kernels_1/compass.descend-3.py311.nbi", 101.0)
    written(package / "geometry/pose.py", 102.0)
    assert forget_outdated(package, str(package / "elsewhere"))
    assert not kept.exists()
    assert not told.exists()


def test_where_it_cannot_be_thrown_away_that_is_said(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(package / "geometry/__pycache__/pose.project-9.py311.nbi", 99.0)

    def refuse(self: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "read-only", str(self), missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse)
    assert not forget_outdated(package)
