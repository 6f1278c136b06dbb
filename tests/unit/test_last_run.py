"""What a daemon runs is noted for whoever has to stop its heads."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from camrig.config.rig_file import load_rig
from camrig.runtime.last_run import forget, keep, last_run
from tests.daemon_on_fakes import RIG

EMULATED = RIG.replace("driver: fake, enable", "driver: pelco_d, enable") + "world: {driver: emulated}\n"


def written(folder: Path, text: str = RIG) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "rig.yaml"
    path.write_text(text)
    return path


def test_it_outlives_a_change_of_the_file_until_it_is_forgotten(tmp_path: Path) -> None:
    file, folder = written(tmp_path / "etc"), tmp_path
    keep(load_rig(file), folder)
    file.write_text("nothing of a rig")
    ran = last_run(file, [folder])
    assert ran is not None
    assert (ran.file, ran.text) == (str(file), RIG)
    forget(file, folder)
    forget(file, folder)
    assert last_run(file, [folder]) is None


def test_another_file_of_the_same_name_is_another_rig(tmp_path: Path) -> None:
    one, other = written(tmp_path / "a"), written(tmp_path / "b")
    keep(load_rig(one), tmp_path)
    assert last_run(other, [tmp_path]) is None
    assert last_run(tmp_path / "a/../a/rig.yaml", [tmp_path]) is not None


def test_an_emulated_rig_leaves_nothing_to_be_stopped(tmp_path: Path) -> None:
    file = written(tmp_path / "etc", EMULATED)
    keep(load_rig(file), tmp_path)
    assert not list(tmp_path.glob("*.running.yaml"))


def test_a_folder_that_cannot_be_written_is_said_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = written(tmp_path / "etc")
    keep(load_rig(file), tmp_path / "absent")
    assert "should the daemon die, `camrig stop` goes by" in caplog.text


@pytest.mark.skipif(os.geteuid() != 0, reason="takes root to give a folder away")
def test_the_folder_of_another_user_is_not_trusted(tmp_path: Path) -> None:
    file = written(tmp_path / "etc")
    keep(load_rig(file), tmp_path)
    os.chown(tmp_path, 65534, -1)
    assert last_run(file, [tmp_path]) is None
