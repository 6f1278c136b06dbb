"""What a head's section of the YAML may say, and how its axes turn degrees into the head's counting."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from camrig.errors import InputError
from camrig.geometry.pan_tilt import PanTilt
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import driver
from camrig_drivers.pelco_d.axis import AxisScale, SpeedTable
from camrig_drivers.pelco_d.section import AxisSection, PelcoDSection


def _spec(name: str, pan_deg: tuple[float, float] = (-170.0, 170.0)) -> HeadSpec:
    pan_rad = (math.radians(pan_deg[0]), math.radians(pan_deg[1]))
    return HeadSpec(name, PanTilt(np.eye(4)), pan_rad, (math.radians(-90.0), math.radians(10.0)), 0.7)


def _check(**sections: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    assert driver.check is not None
    return list(
        driver.check({name: (_spec(name), PelcoDSection.model_validate(keys)) for name, keys in sections.items()})
    )


# --- the section ----------------------------------------------------------------------------------------------


def test_defaults_are_an_upright_head_at_9600_baud() -> None:
    section = PelcoDSection(port="/dev/ttyUSB0")
    assert (section.baud, section.address, section.gap_s, section.reply_timeout_s) == (9600, 1, 0.05, 0.1)
    assert section.axes.pan.sign == section.axes.tilt.sign == -1
    assert section.dialect.turbo is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"port": ""},
        {"baud": 1200},
        {"address": 0},
        {"address": 255},
        {"speed": 3},
        {"gap_s": -0.1},
        {"gap_s": math.nan},
        {"reply_timeout_s": 0.0},
        {"echo": "maybe"},
        {"axes": {"pan": {"sign": 0}}},
        {"axes": {"tilt": {"scale": 0.0}}},
        {"axes": {"roll": {}}},
        {"dialect": {"turbo": 0x41}},
    ],
)
def test_anything_else_is_refused(wrong: Mapping[str, Any]) -> None:
    with pytest.raises(ValidationError):
        PelcoDSection.model_validate({"port": "/dev/ttyUSB0", **wrong})


@pytest.mark.parametrize("echo", ["auto", "yes", "no"])
def test_echo_may_be_written_without_quotes(echo: str) -> None:
    keys = yaml.safe_load(f"{{port: /dev/ttyUSB0, echo: {echo}}}")
    assert PelcoDSection.model_validate(keys).echo == echo


_SPEEDS = {"speeds": {1: 0.5, 63: 40.0}}
_AXES = {"pan": _SPEEDS, "tilt": _SPEEDS}
_ZERO = {"by": "preset", "preset": 5, "pan_deg": 0.0, "tilt_deg": 0.0}


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"grade": "velocity"}, "grade velocity needs axes.pan.speeds"),
        ({"grade": "velocity", "axes": {"pan": _SPEEDS}}, "needs axes.tilt.speeds"),
        ({"grade": "open_loop", "axes": _AXES}, "open_loop goes with grade: open_loop"),
        ({"open_loop": {"zero": _ZERO}}, "open_loop goes with grade: open_loop"),
        ({"axes": {"pan": {"speeds": {}}}}, "give at least one speed byte"),
        ({"axes": {"pan": {"speeds": {1: 5.0, 9: 5.0}}}}, "5 deg/s at 1 and 5 at 9 do not"),
        ({"axes": {"pan": {"speeds": {64: 90.0}}}}, "byte 64 is turbo; give dialect.turbo"),
        ({"axes": {"tilt": {"speeds": {64: 90.0}}}, "dialect": {"turbo": 0x40}}, "tilt has no turbo"),
        ({"refresh_s": 15.0}, "less than or equal to 14"),
        (
            {"grade": "open_loop", "axes": _AXES, "open_loop": {"zero": {**_ZERO, "preset": 95}}},
            "95 is an order to many heads; set special_presets",
        ),
        (
            {"grade": "open_loop", "axes": _AXES, "open_loop": {"zero": {**_ZERO, "by": "end_stops"}}},
            "preset goes with by: preset",
        ),
    ],
)
def test_what_a_grade_needs_and_what_it_does_not_take(keys: Mapping[str, Any], why: str) -> None:
    with pytest.raises(ValidationError) as refused:
        PelcoDSection.model_validate({"port": "/dev/ttyUSB0", **keys})
    assert why in str(refused.value)


def test_a_special_preset_is_allowed_when_asked_for() -> None:
    keys = {
        "grade": "open_loop",
        "axes": _AXES,
        "special_presets": True,
        "open_loop": {"zero": {**_ZERO, "preset": 95}},
    }
    assert PelcoDSection.model_validate({"port": "/dev/ttyUSB0", **keys}).open_loop is not None


@given(speed=st.floats(0.0, 60.0))
def test_a_speed_is_never_more_than_was_wanted(speed: float) -> None:
    table = SpeedTable({1: 0.5, 20: 6.0, 63: 40.0})
    byte = table.byte_for(math.radians(speed))
    assert math.degrees(table.speed_rad_s(byte)) <= speed + 1e-6
    assert byte == 63 or math.degrees(table.speed_rad_s(byte + 1)) > speed - 1e-6


def test_heads_with_a_taken_address_are_one_fault_each() -> None:
    same = {"port": "/dev/x"}
    faults = _check(a=same, b=same, c=same, d={"port": "/dev/x", "address": 3})
    assert [(name, key) for name, key, _ in faults] == [("b", "address"), ("c", "address")]
    assert "taken by head a" in faults[0][2]


def test_two_bauds_on_one_port_are_a_fault() -> None:
    faults = _check(a={"port": "/dev/x"}, b={"port": "/dev/x", "address": 2, "baud": 2400, "echo": "yes"})
    assert [(name, key) for name, key, _ in faults] == [("b", "baud"), ("b", "echo")]


def test_one_address_on_two_ports_is_none() -> None:
    assert _check(a={"port": "/dev/x"}, b={"port": "/dev/y", "baud": 2400}) == []


def test_two_names_of_one_port_are_one_port(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    faults = _check(a={"port": str(tmp_path / "ttyUSB0")}, b={"port": str(tmp_path / "by-id")})
    assert [(name, key) for name, key, _ in faults] == [("b", "address")]


def test_limits_that_read_back_cannot_tell_apart_are_a_fault() -> None:
    assert driver.check is not None
    wide = {"a": (_spec("a", (-200.0, 170.0)), PelcoDSection(port="/dev/x"))}
    assert [(name, key) for name, key, _ in driver.check(wide)] == [("a", "pan_deg")]


def test_discovered_ports_exist() -> None:
    assert driver.discover is not None
    assert all(Path(port.name).exists() for port in driver.discover())


# --- the axes -------------------------------------------------------------------------------------------------


def _axis(limits_deg: tuple[float, float] = (-170.0, 170.0), **keys: Any) -> AxisScale:
    limits_rad = (math.radians(limits_deg[0]), math.radians(limits_deg[1]))
    return AxisScale("pan", AxisSection.model_validate(keys), limits_rad, 0.0)


@pytest.mark.parametrize(
    ("axis", "angle_deg", "raw"),
    [
        (_axis(), 0.0, 0),
        (_axis(), 20.0, 34000),  # counter-clockwise is against Pelco's clockwise
        (_axis(), -45.0, 4500),
        (_axis((-90.0, 10.0)), -90.0, 9000),  # straight down: convention A
        (_axis((-90.0, 10.0)), 10.0, 35000),
        (_axis(sign=1), 20.0, 2000),
        (_axis(sign=1), -0.01, 35999),
        (_axis(offset_deg=150.0), -150.0, 30000),  # pan zero of the head points to our 150
        (_axis(offset_deg=150.0), 150.0, 0),
        (_axis((-40.0, 90.0), scale=1.36, offset_deg=90.0), 20.0, 5147),  # convention E
    ],
)
def test_degrees_and_raw(axis: AxisScale, angle_deg: float, raw: int) -> None:
    assert axis.raw(math.radians(angle_deg)) == raw
    assert math.degrees(axis.angle_rad(raw)) == pytest.approx(angle_deg, abs=0.0051 * axis.section.scale)


def test_36000_is_0() -> None:
    assert _axis().angle_rad(36000) == _axis().angle_rad(0) == 0.0


@given(
    sign=st.sampled_from([-1, 1]),
    scale=st.floats(0.5, 2.0),
    offset_deg=st.floats(-360.0, 360.0),
    middle_deg=st.floats(-180.0, 180.0),
    part=st.floats(0.0, 1.0),
)
def test_every_angle_within_limits_comes_back(
    sign: int, scale: float, offset_deg: float, middle_deg: float, part: float
) -> None:
    low_deg, high_deg = middle_deg - 179.0 * scale, middle_deg + 179.0 * scale
    axis = _axis((low_deg, high_deg), sign=sign, scale=scale, offset_deg=offset_deg)
    angle_rad = math.radians(low_deg + part * (high_deg - low_deg))
    raw = axis.raw(angle_rad)
    assert 0 <= raw < 36000
    assert axis.angle_rad(raw) == pytest.approx(angle_rad, abs=math.radians(0.00501 * scale))


@pytest.mark.parametrize("angle_deg", [170.01, -171.0, 1e6, math.inf, math.nan])
def test_outside_its_limits_nothing_is_commanded(angle_deg: float) -> None:
    with pytest.raises(InputError, match=r"pan .* deg is outside -170.00..170.00 deg"):
        _axis().raw(math.radians(angle_deg))


def test_sigma_counts_last_digit_what_is_unknown_of_the_play_and_what_the_section_says() -> None:
    digit_rad = math.radians(0.01 / math.sqrt(12.0))
    assert _axis().sigma_rad(0.0) == pytest.approx(digit_rad)
    assert _axis(resolution_deg=0.1).sigma_rad(0.0) == pytest.approx(10.0 * digit_rad)
    assert _axis().sigma_rad(math.radians(0.6)) == pytest.approx(math.radians(0.6 / math.sqrt(12.0)), rel=1e-3)
