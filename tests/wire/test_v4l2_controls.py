"""Controls by name: what is set, in which order, and what a user is told."""

import errno

import pytest

from camrig.errors import HardwareError, LinkLost
from camrig_drivers.v4l2.controls import Value, set_controls, variable_name
from camrig_drivers.v4l2.locks import exposure_time_s
from camrig_drivers.v4l2.node import Node
from tests.v4l2_control_bank import EXPOSURE
from tests.v4l2_kernel import G_EXT_CTRLS, PATH, QUERY_EXT_CTRL, S_EXT_CTRLS, FakeKernel, Habits

LABEL = "camera north: /dev/video0"


def apply(kernel: FakeKernel, wanted: dict[str, Value]) -> None:
    node = Node(kernel, PATH)
    try:
        set_controls(node, LABEL, wanted)
    finally:
        node.close()


def refused(kernel: FakeKernel, wanted: dict[str, Value]) -> str:
    with pytest.raises(HardwareError) as caught:
        apply(kernel, wanted)
    assert caught.type is HardwareError
    return str(caught.value)


@pytest.mark.parametrize(
    ("kernels", "ours"),
    [
        ("Exposure Time, Absolute", "exposure_time_absolute"),
        ("Brightness", "brightness"),
        ("White Balance, Automatic", "white_balance_automatic"),
        ("  Gain (dB) ", "gain_db"),
        ("75% Colorbar", "75_colorbar"),
    ],
)
def test_names_are_those_of_v4l2_ctl(kernels: str, ours: str) -> None:
    assert variable_name(kernels) == ours


def test_automatic_modes_are_switched_before_what_they_govern() -> None:
    kernel = FakeKernel()
    governed: dict[str, Value] = {"exposure_time_absolute": 20, "gain": 35, "brightness": -3}
    apply(kernel, {**governed, "auto_exposure": "manual", "focus_automatic_continuous": False})
    assert kernel.controls.values_set == [
        ("Auto Exposure", 1),
        ("Focus, Automatic Continuous", 0),
        ("Exposure Time, Absolute", 20),
        ("Gain", 35),
        ("Brightness", -3),
    ]


def test_every_control_is_read_back() -> None:
    kernel = FakeKernel()
    apply(kernel, {"brightness": 5, "power_line_frequency": 2})
    assert kernel.calls.count(G_EXT_CTRLS) == 2


def test_a_device_that_takes_another_value_is_found_out() -> None:
    kernel = FakeKernel(Habits(clips=(EXPOSURE,)))
    told = refused(kernel, {"auto_exposure": "manual", "exposure_time_absolute": 20})
    assert told == (
        f"{LABEL}: control exposure_time_absolute was set to 20, but the device holds 10; ask for that or another value"
    )


@pytest.mark.parametrize(
    ("value", "number"), [("50 Hz", 1), ("50_hz", 1), ("60", 2), ("disabled", 0), ("Disabled", 0), (2, 2)]
)
def test_menu_items_by_name_first_words_or_number(value: Value, number: int) -> None:
    kernel = FakeKernel()
    apply(kernel, {"power_line_frequency": value})
    assert kernel.controls.held("Power Line Frequency") == number


def test_items_of_a_menu_of_numbers_by_what_they_say() -> None:
    kernel = FakeKernel()
    apply(kernel, {"link_frequency": "900000000"})
    assert kernel.controls.held("Link Frequency") == 1


@pytest.mark.parametrize(("value", "number"), [(True, 1), (False, 0), (1, 1), (0, 0)])
def test_switches(value: Value, number: int) -> None:
    kernel = FakeKernel()
    apply(kernel, {"focus_automatic_continuous": value})
    assert kernel.controls.held("Focus, Automatic Continuous") == number


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("brightness", 65, "is 65; allowed: -64 to 64"),
        ("brightness", -65, "is -65; allowed: -64 to 64"),
        ("brightness", "high", "is 'high'; allowed: -64 to 64"),
        ("brightness", True, "is True; allowed: -64 to 64"),
        ("gain", 7, "is 7; allowed: 0 to 100 in steps of 5"),
        ("focus_automatic_continuous", 2, "is 2; allowed: true, false"),
        ("focus_automatic_continuous", "off", "is 'off'; allowed: true, false"),
        ("auto_exposure", "auto", "is 'auto'; allowed: manual_mode (1), aperture_priority_mode (3)"),
        ("auto_exposure", 0, "is 0; allowed: manual_mode (1), aperture_priority_mode (3)"),
        ("auto_exposure", True, "is True; allowed: manual_mode (1), aperture_priority_mode (3)"),
    ],
)
def test_what_is_not_allowed_is_refused_with_what_is(name: str, value: Value, allowed: str) -> None:
    kernel = FakeKernel()
    assert refused(kernel, {"power_line_frequency": 0, name: value}) == f"{LABEL}: control {name} {allowed}"
    assert kernel.controls.values_set == [], "nothing is set before all is checked"


def test_unknown_names_are_refused_with_the_known() -> None:
    """Neither the headline of a class, nor a button, nor what the device has switched off can be set."""
    told = refused(FakeKernel(), {"exposure": 1, "brightness": 2, "user_controls": 3, "reset": 1, "broken": 1})
    assert told == (
        f"{LABEL} has no control exposure, user_controls, reset, broken; it has: auto_exposure, brightness, "
        "exposure_time_absolute, focus_automatic_continuous, gain, link_frequency, power_line_frequency, serial_number"
    )


def test_a_device_without_controls_says_so() -> None:
    kernel = FakeKernel()
    kernel.faults[QUERY_EXT_CTRL] = errno.ENOTTY
    assert refused(kernel, {"gain": 5}) == f"{LABEL} has no control gain; it has: none"


def test_read_only_controls_cannot_be_set() -> None:
    assert "serial_number can only be read" in refused(FakeKernel(), {"serial_number": 1})


def test_what_an_automatic_mode_governs_needs_it_switched_off() -> None:
    kernel = FakeKernel()
    assert "has no effect while an automatic mode governs it" in refused(kernel, {"exposure_time_absolute": 20})
    assert kernel.controls.values_set == []


def test_a_refusal_of_the_device_is_told() -> None:
    kernel = FakeKernel()
    kernel.faults[S_EXT_CTRLS] = errno.EBUSY
    assert "control brightness was refused the value 3" in refused(kernel, {"brightness": 3})


def test_trouble_on_the_bus_may_pass() -> None:
    kernel = FakeKernel()
    kernel.faults[S_EXT_CTRLS] = errno.EIO
    with pytest.raises(OSError, match="Input/output error") as caught:
        apply(kernel, {"brightness": 3})
    assert not isinstance(caught.value, LinkLost)  # the camera makes one of it


def test_a_64_bit_value_is_read_whole() -> None:
    kernel = FakeKernel()
    node = Node(kernel, PATH)
    assert node.value(node.control(0x98A002)) == 1 << 33
    node.close()


def test_the_exposure_is_told_in_seconds_where_it_is_fixed() -> None:
    kernel = FakeKernel()
    node = Node(kernel, PATH)
    assert exposure_time_s(node) is None
    set_controls(node, LABEL, {"auto_exposure": "manual", "exposure_time_absolute": 20})
    assert exposure_time_s(node) == pytest.approx(0.002)
    node.close()
