"""From a rig and its YAML to emulated devices: start aims, limits, shared lines, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.errors import InputError
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_x
from camrig.rig import CameraSpec, DroneMount, DroneSpec, FreeMount, HeadMount, HeadSpec, Mount, Rig, Space
from camrig_emulators import world_settings
from camrig_emulators.world import driver
from camrig_emulators.world_section import WorldSection

LENS = BrownLens((1280, 720), (820.0, 820.0), (640.0, 360.0))
LIMITS = ((math.radians(-170.0), math.radians(170.0)), (math.radians(-90.0), math.radians(10.0)))
OPTICAL = transform(R_MOUNT_OPTICAL, np.zeros(3))


def head(name: str, x_m: float, y_m: float, *, inverted: bool = False) -> HeadSpec:
    R = rotation_x(math.pi) if inverted else np.eye(3)
    return HeadSpec(name, PanTilt(transform(R, np.array([x_m, y_m, 2.8]))), *LIMITS, speed_rad_s=math.radians(40.0))


def rig(mount: Mount | None = None) -> Rig:
    heads = {"pt1": head("pt1", 0.0, 0.0), "pt2": head("pt2", 6.0, 4.0), "pt3": head("pt3", 3.0, 4.0, inverted=True)}
    drones = {name: DroneSpec(name, ((0.0, 0.0, 1.0), (6.0, 4.0, 2.5)), 0.8, 0.5) for name in ("d1", "d2")}
    cameras = {"north": CameraSpec("north", LENS, mount or HeadMount("pt1", OPTICAL))}
    return Rig("lab", Space(((0.0, 0.0), (6.0, 4.0))), cameras, heads, drones)


DEVICES: Mapping[str, Mapping[str, Any]] = {
    "north": {"driver": "rendered", "fps": 8},
    "pt1": {"driver": "pelco_d", "baud": 4800, "address": 3, "port": "bus", "axes": {"pan": {"sign": 1}}},
    "pt2": {"driver": "pelco_d", "baud": 4800, "address": 4, "port": "bus"},
    "pt3": {"driver": "pelco_d"},
    "d1": {"driver": "mavlink", "system": 7},
    "d2": {"driver": "mavlink"},
}


def test_heads_that_name_one_port_share_a_line() -> None:
    lines = world_settings.head_lines(rig(), WorldSection(), DEVICES)
    assert [[settings.id for settings in line] for line in lines] == [["pt1", "pt2"], ["pt3"]]
    first = lines[0][0]
    assert (first.address, first.baud, first.axes.pan.sign, first.axes.tilt.sign) == (3, 4800, 1, -1)
    assert first.max_speed_deg_s == pytest.approx(40.0)
    assert first.pan_limits_deg == pytest.approx((-171.0, 171.0))
    assert first.backlash_deg == 0.05
    assert first.readback_step_deg == 0.01


def test_heads_start_at_the_rooms_middle_45_deg_down() -> None:
    lines = world_settings.head_lines(rig(), WorldSection(), DEVICES)
    starts = {s.id: (s.start_pan_deg, s.start_tilt_deg) for line in lines for s in line}
    bearing_deg = math.degrees(math.atan2(4.0, 6.0))
    assert starts["pt1"] == pytest.approx((bearing_deg, -45.0))
    assert starts["pt2"] == pytest.approx((bearing_deg - 180.0, -45.0))
    # Upside down its tilt counts the other way: 45 deg down would be +45, past its limit of 10.
    assert starts["pt3"] == pytest.approx((90.0, 10.0))


def test_overrides_win_and_imperfections_come_from_the_seed() -> None:
    section = WorldSection.model_validate({"heads": {"pt1": {"start_pan_deg": 10, "zero_error_deg": [0.2, -0.1]}}})
    lines = world_settings.head_lines(rig(), section, DEVICES)
    assert lines[0][0].start_pan_deg == 10.0
    assert lines[0][0].zero_error_deg == (0.2, -0.1)
    again, other = (
        [s.zero_error_deg for line in world_settings.head_lines(rig(), WorldSection(seed=seed), DEVICES) for s in line]
        for seed in (1, 2)
    )
    assert lines[0][1].zero_error_deg == again[1]
    assert again[1] != other[1]
    errors = np.array(
        [
            settings.zero_error_deg
            for seed in range(40)
            for line in world_settings.head_lines(rig(), WorldSection(seed=seed), DEVICES)
            for settings in line
        ]
    )
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.05, rel=0.2)


def test_drones_start_on_the_floor_about_its_middle() -> None:
    first, second = world_settings.drones(rig(), WorldSection(), DEVICES)
    assert (first.id, first.system, first.start_position_m) == ("d1", 7, (2.5, 2.0, 0.0))
    assert (second.id, second.system, second.start_position_m) == ("d2", 1, (3.5, 2.0, 0.0))
    section = WorldSection.model_validate({"drones": {"d1": {"start_position_m": [1, 1, 0], "flavour": "px4"}}})
    first, _ = world_settings.drones(rig(), section, DEVICES)
    assert (first.start_position_m, first.flavour) == ((1.0, 1.0, 0.0), "px4")


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"heads": {"pt9": {}}}, r"world\.heads: pt9 is none of the rig's heads \(pt1, pt2, pt3\)"),
        ({"drones": {"d9": {}}}, r"world\.drones: d9 is none of the rig's drones \(d1, d2\)"),
        ({"heads": {"pt1": {"start_tilt_deg": 60}}}, "emulated pt1: .*start_tilt_deg 60 is outside"),
    ],
)
def test_sections_that_do_not_fit_the_rig_are_refused(section: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        driver.make(rig(), WorldSection.model_validate(section), DEVICES)


@pytest.mark.parametrize(
    ("mount", "devices", "message"),
    [
        (FreeMount(), {}, "camera north: a rendered camera needs a mount"),
        (HeadMount("pt1", OPTICAL), {"pt1": {"driver": "fake"}}, "camera north: its head pt1 is not emulated"),
        (
            DroneMount("d1", transform(R_BODY_OPTICAL_DOWN, np.zeros(3))),
            {"d1": {"driver": "fake"}},
            "camera north: its drone d1 is not emulated",
        ),
    ],
)
def test_cameras_that_cannot_be_drawn_are_refused(
    mount: Mount, devices: Mapping[str, Mapping[str, Any]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        driver.make(rig(mount), WorldSection(), {**DEVICES, **devices})


@pytest.mark.parametrize(
    "section",
    [
        {"sead": 1},
        {"exposure_s": 0.0},
        {"robot_speed_m_s": [0.4, 0.1]},
        {"heads": {"pt1": {"speed": 3}}},
        {"noise_grey": float("nan")},
    ],
)
def test_a_wrong_section_is_refused(section: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        WorldSection.model_validate(section)
