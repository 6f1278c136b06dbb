"""``camrig devices``, ``doctor``, ``init`` and ``check --open`` on the real command line, with a lab's own driver."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from camrig.cli.main import main
from camrig.interfaces import Driver, Found
from camrig_drivers.v4l2 import V4l2Section
from camrig_drivers.v4l2.discovery import discover
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import Habits

Ask = Callable[..., tuple[int, str, str]]

SIZE_PX = (640, 480)
HUB = Hub([camera_at("/dev/video0", "usb-1", serial="A1", habits=Habits(formats={"YUYV": (SIZE_PX,)}))])


def _discover() -> list[Found]:
    ours = [*discover(HUB)]
    return [Found(found.name, found.title, found.section, found.size_px, found.facts, TROUBLE) for found in ours]


TROUBLE = ""
driver: Driver[object, object] = Driver(section=V4l2Section, make=dict, discover=_discover)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a camera driver of a lab's own, found by its entry point alone."""
    folder = tmp_path / "site"
    metadata = folder / "lab_cameras-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-cameras\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[camrig.cameras]\nv4l2-lab = {__name__}:driver\n")
    monkeypatch.syspath_prepend(folder)


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ask:
    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["camrig", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capsys.readouterr()
        return int(caught.value.code or 0), out, err

    return run


@pytest.mark.usefixtures("lab")
def test_devices_are_told_as_one_object(ask: Ask) -> None:
    code, out, _ = ask("devices", "--json")
    assert code == 0
    (line,) = out.splitlines()
    cameras = {camera["name"]: camera for camera in json.loads(line)["cameras"]}
    camera = cameras["bus=usb-1"]
    assert camera["drivers"] == ["v4l2-lab"]
    assert camera["trouble"] is None
    assert camera["serial"] == "A1"
    assert camera["section"] == {"device": "bus=usb-1", "format": "YUYV", "fps": 30.0}
    assert camera["modes"] == [{"format": "YUYV", "size_px": "640x480", "fps": [30.0, 15.0]}]
    assert camera["controls"]["brightness"]["maximum"] == 64


OTHERS = ("auto_exposure = aperture_priority_mode (manual_mode, ", "focus_automatic_continuous = true (true, false)")


@pytest.mark.usefixtures("lab")
def test_devices_are_told_to_people(ask: Ask) -> None:
    code, out, _ = ask("devices")
    assert code == 0
    for words in (
        "Test Camera at usb-1",
        "bus=usb-1",
        "YUYV: 640x480 at 30 fps",
        "brightness = 0 (-64 to 64)",
        *OTHERS,
    ):
        assert words in out


@pytest.mark.usefixtures("lab")
def test_doctor_ends_with_3_where_something_is_red(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "TROUBLE", "it is in use by cheese (pid 7); stop that first")
    code, out, err = ask("doctor", "--json")
    assert code == 3
    told = json.loads(out)
    assert told["health"] == "red"
    red = [finding for finding in told["findings"] if finding["health"] == "red" and finding["about"] == "cameras"]
    assert red == [
        {
            "about": "cameras",
            "health": "red",
            "says": "bus=usb-1: it is in use by cheese (pid 7)",
            "cure": "stop that first",
        }
    ]
    assert {"clock", "detection", "kernels", "disk", "groups"} <= {finding["about"] for finding in told["findings"]}
    assert "this computer is not fit yet" in err


def test_doctor_tells_people(ask: Ask) -> None:
    code, out, _ = ask("doctor")
    assert code in (0, 3)
    assert "detection" in out
    assert "disk" in out


@pytest.mark.usefixtures("lab")
def test_init_writes_a_file_that_names_the_camera_and_never_overwrites(ask: Ask, tmp_path: Path) -> None:
    file = tmp_path / "lab-a.yaml"
    code, out, _ = ask("init", file)
    assert code == 0
    assert "1 cameras" in out
    text = file.read_text()
    assert 'source: {driver: "v4l2-lab", device: "bus=usb-1", format: "YUYV", fps: 30.0}' in text
    assert "rig: lab-a" in text
    code, _, err = ask("init", file)
    assert code == 2
    assert "exists and is left alone" in err
    assert file.read_text() == text


def test_init_where_nothing_can_be_written_is_one_sentence(ask: Ask, tmp_path: Path) -> None:
    code, _, err = ask("init", tmp_path / "no" / "rig.yaml")
    assert code == 2
    assert "cannot be written: No such file or directory" in err


RIG = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}
cameras:
  - {id: north, lens: lab, source: {driver: fake}, mount: {fixed: {position_m: [1, 1, 2.8]}}}
targets:
  - {id: robot1, tags: [{id: 7, size_m: 0.12}]}
"""


def test_check_opens_cameras_when_told_and_names_every_one_that_fails(ask: Ask, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(RIG)
    assert ask("check", "--open", file)[0] == 0
    more = "".join(
        f"  - {{id: {name}, lens: lab, source: {{driver: v4l2, device: {device}}}, "
        "mount: {fixed: {position_m: [1, 2, 2.8]}}}\n"
        for name, device in (("south", "/dev/video99"), ("east", "/dev/null"))
    )
    file.write_text(RIG.replace("targets:", f"{more}targets:"))
    assert ask("check", file)[0] == 0
    code, _, err = ask("check", "--open", file)
    assert code == 3
    assert "camera south: /dev/video99 does not exist; check the cable and the name" in err
    assert "camera east: /dev/null is no V4L2 camera; `camrig devices` lists those plugged in" in err
