"""What is plugged in: each camera once, by the name that lasts longest, with all that it can do."""

from __future__ import annotations

import json
from pathlib import Path

from camrig_drivers.v4l2.discovery import discover
from camrig_drivers.v4l2.port import KernelPort
from camrig_drivers.v4l2.section import V4l2Section
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import Habits

BY_ID = "/dev/v4l/by-id/usb-Maker_Camera-video-index0"
BY_PATH = "/dev/v4l/by-path/pci-usb-0:1-video-index0"


def test_cameras_are_listed_once_by_the_name_that_lasts_longest() -> None:
    cameras = [camera_at(f"/dev/video{number}", f"usb-1.{number}") for number in range(2)]
    hub = Hub(cameras, {"/dev/video0": [BY_ID, BY_PATH]})
    found = discover(hub)
    assert [each.name for each in found] == [BY_ID, "bus=usb-1.1"]
    assert found[0].facts["names"] == [BY_ID, BY_PATH, "bus=usb-1.0", "/dev/video0"]
    assert [each.title for each in found] == ["Test Camera at usb-1.0", "Test Camera at usb-1.1"]
    assert all(camera.free for camera in cameras)


def test_what_two_nodes_share_names_neither() -> None:
    hub = Hub([camera_at("/dev/video0", "usb-1"), camera_at("/dev/video1", "usb-1")])
    assert [each.name for each in discover(hub)] == ["/dev/video0", "/dev/video1"]


def test_a_node_without_pictures_is_left_out_and_one_that_cannot_be_asked_is_not() -> None:
    metadata = camera_at("/dev/video1", "usb-1", habits=Habits(device_capabilities=0x04A00000))
    hub = Hub([camera_at("/dev/video0", "usb-0"), metadata, camera_at("/dev/video2", "usb-2")], denied={"/dev/video2"})
    found = discover(hub)
    assert [each.name for each in found] == ["bus=usb-0", "/dev/video2"]
    assert "may not be opened by this user; add the user to the group" in found[1].trouble
    assert metadata.free


def test_modes_and_controls_are_told_as_json() -> None:
    (found,) = discover(Hub([camera_at("/dev/video0", "usb-0", serial="A1")]))
    facts = json.loads(json.dumps(found.facts))
    assert facts["serial"] == "A1"
    assert facts["modes"] == [
        {"format": "YUYV", "size_px": "64x48", "fps": [30.0, 15.0]},
        {"format": "YUYV", "size_px": "32x24", "fps": [30.0, 15.0]},
        {"format": "MJPG", "size_px": "64x48", "fps": [30.0, 15.0]},
    ]
    controls = facts["controls"]
    assert controls["brightness"] == {"kind": "number", "minimum": -64, "maximum": 64, "step": 1, "value": 0}
    assert controls["auto_exposure"]["items"] == {"manual_mode": 1, "aperture_priority_mode": 3}
    assert controls["exposure_time_absolute"]["governed"] is True
    assert controls["serial_number"]["read_only"] is True


def test_the_section_is_the_largest_picture_that_comes_often_enough() -> None:
    sizes = ((640, 480), (1280, 720), (3840, 2160))
    habits = Habits(formats={"MJPG": sizes, "YUYV": sizes, "RGB3": sizes})
    (found,) = discover(Hub([camera_at("/dev/video0", "usb-0", habits=habits)]))
    assert found.size_px == (1280, 720)
    assert V4l2Section.model_validate(found.section).format == "YUYV"
    assert found.section["fps"] == 30.0


def test_a_camera_without_a_format_for_us_says_so() -> None:
    (found,) = discover(Hub([camera_at("/dev/video0", "usb-0", habits=Habits(formats={"RGB3": ((64, 48),)}))]))
    assert found.trouble == "it offers no format that camrig reads"
    assert found.size_px is None


def test_the_file_system_is_asked_for_nodes_names_and_serial_numbers(tmp_path: Path) -> None:
    dev, sys = tmp_path / "dev", tmp_path / "sys"
    for folder in ("by-id", "by-path"):
        (dev / "v4l" / folder).mkdir(parents=True)
    for number in (0, 2, 10):
        (dev / f"video{number}").touch()
    (dev / "v4l/by-path/pci-1").symlink_to(dev / "video2")
    (dev / "v4l/by-id/usb-1").symlink_to(dev / "video2")
    interface = sys / "devices/usb1/1-1/1-1:1.0"
    interface.mkdir(parents=True)
    (interface.parent / "serial").write_text("A1B2\n")
    (sys / "class/video4linux/video2").mkdir(parents=True)
    (sys / "class/video4linux/video2/device").symlink_to(interface)
    port = KernelPort(dev, sys)
    assert port.nodes() == [str(dev / f"video{number}") for number in (0, 2, 10)]
    assert port.links() == {str(dev / "video2"): [str(dev / "v4l/by-id/usb-1"), str(dev / "v4l/by-path/pci-1")]}
    assert port.usb_serial(str(dev / "v4l/by-id/usb-1")) == "A1B2"
    assert port.usb_serial(str(dev / "video0")) == ""


def test_nothing_plugged_in_is_an_empty_list(tmp_path: Path) -> None:
    assert discover(KernelPort(tmp_path, tmp_path)) == []
