"""The YAML section, and faults between cameras."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.geometry.lens import BrownLens
from camrig.plugins import load_driver
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import driver
from camrig_drivers.v4l2.section import V4l2Section, check


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


def test_exposure_is_ruled_by_one_alone() -> None:
    blur = {"max_blur_px": 1.0, "speed_deg_s": 30.0}
    with pytest.raises(ValidationError, match="`exposure` rules exposure_time_absolute itself"):
        V4l2Section.model_validate(
            {"device": "/dev/video0", "exposure": blur, "controls": {"exposure_time_absolute": 20}}
        )
    section = V4l2Section.model_validate({"device": "/dev/video0", "exposure": blur, "controls": {"brightness": 3}})
    assert section.exposure is not None
    assert section.exposure.longest_s(900.0) == pytest.approx(1.0 / (np.radians(30.0) * 900.0))
