"""The YAML section, faults between cameras, and what is found plugged in."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.geometry.lens import BrownLens
from camrig.plugins import load_driver
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import driver
from camrig_drivers.v4l2.discovery import discover
from camrig_drivers.v4l2.section import V4l2Section, check
from tests.v4l2_kernel import PATH, FakeKernel, Habits


def spec(name: str) -> CameraSpec:
    return CameraSpec(name, BrownLens((64, 48), (60.0, 60.0), (31.5, 23.5)), FreeMount())


def test_the_driver_is_installed_as_v4l2_and_building_opens_nothing() -> None:
    assert load_driver("cameras", "v4l2") is driver
    section = driver.section(device="/dev/no-such-device")
    assert set(driver.make({"north": (spec("north"), section)})) == {"north"}


def test_a_section_as_the_yaml_has_it() -> None:
    section = V4l2Section.model_validate(
        {
            "device": "/dev/video0",
            "fps": 30,
            "controls": {"auto_exposure": "manual", "exposure_time_absolute": 20, "focus_automatic_continuous": False},
        }
    )
    assert section.format == "YUYV"
    assert section.fps == 30.0
    assert section.exposure_s is None
    assert list(section.controls.values()) == ["manual", 20, False]
    assert section.controls["focus_automatic_continuous"] is False


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"device": ""},
        {"device": "/dev/video0", "format": "RGB3"},
        {"device": "/dev/video0", "fps": 0},
        {"device": "/dev/video0", "fps": np.inf},
        {"device": "/dev/video0", "controls": {"gain": 0.5}},
        {"device": "/dev/video0", "exposure_s": -0.01},
        {"device": "/dev/video0", "width": 640},
    ],
)
def test_wrong_sections_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        V4l2Section.model_validate(wrong)


def test_a_wrong_control_value_is_one_fault() -> None:
    with pytest.raises(ValidationError) as caught:
        V4l2Section.model_validate({"device": "/dev/video0", "controls": {"gain": 0.5}})
    assert [fault["loc"] for fault in caught.value.errors()] == [("controls", "gain")]


def test_two_cameras_on_one_device_are_a_fault_whatever_they_call_it(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    link = tmp_path / "usb-camera"
    link.symlink_to(node)
    cameras = {
        name: (spec(name), V4l2Section(device=str(device)))
        for name, device in {"a": node, "b": link, "c": tmp_path / "video1"}.items()
    }
    assert check(cameras) == [("b", "device", f"{link} is already the device of camera a")]


class DevKernel(FakeKernel):
    """Knows the same camera, or node of metadata, under a path of the test's own."""

    def __init__(self, path: Path, habits: Habits) -> None:
        super().__init__(habits)
        self._path = str(path)

    def open(self, path: str) -> int:
        return super().open(PATH if path == self._path else path)


def plugged_in(dev: Path) -> None:
    for folder in ("v4l/by-id", "v4l/by-path"):
        (dev / folder).mkdir(parents=True)
    for number in range(3):
        (dev / f"video{number}").touch()
    (dev / "v4l/by-path/pci-usb-0:1-video-index0").symlink_to(dev / "video0")
    (dev / "v4l/by-id/usb-Maker_Camera-video-index0").symlink_to(dev / "video0")
    (dev / "v4l/by-path/pci-usb-0:2-video-index0").symlink_to(dev / "video1")


def test_cameras_are_listed_once_by_their_steadiest_name(tmp_path: Path) -> None:
    plugged_in(tmp_path)
    kernel = DevKernel(tmp_path / "video0", Habits())
    assert discover(kernel, tmp_path) == [
        str(tmp_path / "v4l/by-id/usb-Maker_Camera-video-index0"),
        str(tmp_path / "v4l/by-path/pci-usb-0:2-video-index0"),
        str(tmp_path / "video2"),
    ]
    assert kernel.free


def test_a_node_without_pictures_is_left_out(tmp_path: Path) -> None:
    plugged_in(tmp_path)
    kernel = DevKernel(tmp_path / "video0", Habits(device_capabilities=0x04A00000))
    assert str(tmp_path / "v4l/by-id/usb-Maker_Camera-video-index0") not in discover(kernel, tmp_path)
    assert kernel.free


def test_nothing_plugged_in_is_an_empty_list(tmp_path: Path) -> None:
    assert discover(dev=tmp_path) == []
