"""Drivers are found by entry point; a name that is not there is answered with those that are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from camrig import plugins
from camrig.errors import InputError
from camrig.interfaces import Driver, Plugin, WorldPlugin


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, entry_points: str) -> None:
    """Put a distribution with these entry points on the path."""
    metadata = folder / "lab_drivers-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-drivers\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    monkeypatch.syspath_prepend(folder)


def test_the_installed_names_are_sorted() -> None:
    assert plugins.names("heads") == ("fake", "pelco_d", "uvc", "visca")
    assert set(plugins.names("cameras")) >= {"fake", "images", "rendered", "v4l2"}
    assert "jsonl" in plugins.names("sinks")


def test_each_group_gives_its_kind() -> None:
    assert isinstance(plugins.load_driver("heads", "pelco_d"), Driver)
    assert isinstance(plugins.load_driver("drones", "mavlink"), Driver)
    assert isinstance(plugins.load_plugin("sinks", "jsonl"), Plugin)
    assert isinstance(plugins.load_world("emulated"), WorldPlugin)


def test_an_unknown_name_lists_the_installed_ones() -> None:
    with pytest.raises(
        InputError, match="no driver 'pelco' among the installed heads; installed: fake, pelco_d, uvc, visca"
    ):
        plugins.load_driver("heads", "pelco")
    with pytest.raises(InputError, match="no driver 'mqtt' among the installed sinks; installed: jsonl"):
        plugins.load_plugin("sinks", "mqtt")
    with pytest.raises(InputError, match="installed: emulated"):
        plugins.load_world("gazebo")


def test_a_driver_of_another_package_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lab_drivers.py").write_text(
        "from camrig.interfaces import Driver\ndriver = Driver(section=object, make=dict)\n"
    )
    install(tmp_path, monkeypatch, "[camrig.heads]\nonvif = lab_drivers:driver\n")
    assert plugins.names("heads") == ("fake", "onvif", "pelco_d", "uvc", "visca")
    assert plugins.load_driver("heads", "onvif").section is object


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("no_such_module:driver", "the driver 'broken' of heads cannot be loaded: No module named 'no_such_module'"),
        ("camrig.outputs.jsonl:nothing", "the driver 'broken' of heads cannot be loaded: .*'nothing'"),
        ("camrig.outputs.jsonl:driver", "entry point camrig.heads:broken is no camrig.interfaces.Driver"),
    ],
)
def test_a_driver_that_cannot_be_used_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str, says: str
) -> None:
    install(tmp_path, monkeypatch, f"[camrig.heads]\nbroken = {target}\n")
    with pytest.raises(InputError, match=says):
        plugins.load_driver("heads", "broken")


def test_only_the_driver_that_is_asked_for_is_imported() -> None:
    program = (
        "import sys; from camrig import plugins; plugins.load_driver('heads', 'fake');"
        "print([name for name in ('camrig_drivers.mavlink', 'camrig_drivers.pelco_d', 'serial', 'pymavlink')"
        " if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"
