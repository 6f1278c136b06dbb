"""What an autopilot must be set to before it may fly, and how it is asked."""

from __future__ import annotations

import math

import pytest

from camrig_drivers.mavlink.box import clamped
from camrig_drivers.mavlink.fitness import advice, unfit
from camrig_drivers.mavlink.flavours import ARDUCOPTER, PX4, Flavour
from camrig_drivers.mavlink.packets import ParamRead, ParamValue, SetOrigin
from camrig_drivers.mavlink.parameters import Parameters, rules_of
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import VehicleSettings
from camrig_drivers.mavlink.watch import Needs
from tests.mavlink_copter import BOTH, SPEC, Flight, param_value

DEFAULTS = [
    (ARDUCOPTER, "FS_GCS_ENABLE", 0.0, "parameter FS_GCS_ENABLE is 0, set it to 5 (land)"),
    (ARDUCOPTER, "GUID_TIMEOUT", 3.0, "parameter GUID_TIMEOUT is 3, set it to at most 1 s"),
    (ARDUCOPTER, "MAV_GCS_SYSID", 245.0, "parameter MAV_GCS_SYSID is 245, set it to 255 (camrig)"),
    (PX4, "COM_OBL_RC_ACT", 0.0, "parameter COM_OBL_RC_ACT is 0, set it to 4 (land) or 5 (hold)"),
    (PX4, "NAV_DLL_ACT", 0.0, "parameter NAV_DLL_ACT is 0, set it to 3 (land) or 1 (hold)"),
    (PX4, "COM_OF_LOSS_T", 2.0, "parameter COM_OF_LOSS_T is 2, set it to 1 s"),
    (PX4, "COM_OF_LOSS_T", 0.5, "parameter COM_OF_LOSS_T is 0.5, set it to 1 s"),
]


@pytest.mark.parametrize(("flavour", "name", "value", "text"), DEFAULTS)
def test_each_failsafe_that_is_not_set_is_named_with_its_cure(
    flavour: Flavour, name: str, value: float, text: str
) -> None:
    flight = Flight(flavour, parameters={name: value})
    flight.run(2.0)
    (reason,) = unfit(flight.vehicle, flight.now_s)
    assert reason.startswith(text)


@BOTH
def test_all_reasons_are_named_at_once(flavour: Flavour) -> None:
    flight = Flight(flavour, parameters={"FS_GCS_ENABLE": 0.0, "COM_OBL_RC_ACT": 0.0}, battery=0.2, prearm_ok=False)
    flight.run(2.0)
    assert len(list(unfit(flight.vehicle, flight.now_s))) == 3


@BOTH
def test_what_could_be_better_does_not_forbid_to_fly(flavour: Flavour) -> None:
    names = {"FENCE_ENABLE": 0.0, "GF_ACTION": 3.0}
    flight = Flight(flavour, parameters=names, battery=None)
    flight.run(2.0)
    assert list(unfit(flight.vehicle, flight.now_s)) == []
    said = list(advice(flight.vehicle))
    assert len(said) == 2
    assert "battery" in said[1]


def test_an_older_ardupilot_tells_the_same_under_another_name() -> None:
    parameters = Parameters(ARDUCOPTER, rules_of(ARDUCOPTER, vision=False))
    for name, value in {"FS_GCS_ENABLE": 5.0, "GUID_TIMEOUT": 0.5, "SYSID_MYGCS": 254.0}.items():
        parameters.hear(ParamValue(name, value, 9))
    assert [text.split(" (")[0] for text in parameters.mismatches(needed=True)] == [
        "parameter SYSID_MYGCS is 254, set it to 255"
    ]


@pytest.mark.parametrize("value", [0, 4, -1, 123456789])
def test_px4_s_integers_are_bits_of_a_float(value: int) -> None:
    parameters = Parameters(PX4, rules_of(PX4, vision=False))
    parameters.hear(param_value("COM_OBL_RC_ACT", float(value), raw=True))
    said = [text for text in parameters.mismatches(needed=True) if "COM_OBL_RC_ACT" in text]
    assert said == [] if value == 4 else f"is {value:g}," in said[0]


def test_questions_come_in_batches_are_repeated_and_end() -> None:
    """Nothing is asked for ever, and a silent parameter counts as not there."""
    parameters = Parameters(ARDUCOPTER, rules_of(ARDUCOPTER, vision=True))
    asked: list[ParamRead] = []
    for step in range(600):
        batch = parameters.due(0.1 * step, idle=False)
        assert len(batch) <= 6
        asked += batch
    assert {asked.count(question) for question in asked} == {5}
    assert parameters.complete
    assert "is not told" in next(parameters.mismatches(needed=True))


def test_values_are_asked_again_while_it_stands_idle_and_not_in_flight() -> None:
    parameters = Parameters(PX4, rules_of(PX4, vision=False))
    for name in ("COM_OBL_RC_ACT", "NAV_DLL_ACT", "COM_OF_LOSS_T", "NAV_RCL_ACT", "COM_LOW_BAT_ACT", "GF_ACTION"):
        parameters.hear(ParamValue(name, 1.0, 9))
    first = parameters.due(0.0, idle=True)
    assert len(first) == 6
    assert parameters.due(30.0, idle=False) == []
    assert len(parameters.due(31.0, idle=True)) == 6


@BOTH
def test_reboot_asks_for_everything_again(flavour: Flavour) -> None:
    flight = Flight(flavour)
    flight.run(2.0)
    since_s = flight.now_s
    flight.copter.booted_s = since_s - 1.0
    flight.copter.parameters = {"FS_GCS_ENABLE": 0.0, "COM_OBL_RC_ACT": 0.0}
    flight.run(2.0)
    assert any("ENABLE" in text or "OBL" in text for text in unfit(flight.vehicle, flight.now_s))


def test_arducopter_by_vision_is_given_an_origin_once_and_it_is_checked() -> None:
    origin = SetOrigin(47.0, 8.0, 400.0)
    flight = Flight(ARDUCOPTER, VehicleSettings(needs=Needs(vision=True), origin=origin))
    flight.run(1.0)
    assert "has not taken a global origin" in "; ".join(unfit(flight.vehicle, flight.now_s))
    flight.run(10.0)
    assert [said for _, said in flight.said if isinstance(said, SetOrigin)] == [origin]
    assert "global origin" not in "; ".join(unfit(flight.vehicle, flight.now_s))
    assert flight.vehicle.phase is Phase.PASSIVE


def test_vision_needs_what_the_page_says() -> None:
    flight = Flight(PX4, VehicleSettings(needs=Needs(vision=True)), parameters={"EKF2_EV_CTRL": 1.0})
    flight.run(4.0)
    said = "; ".join(unfit(flight.vehicle, flight.now_s))
    assert "EKF2_EV_CTRL is 1, set it to 11 (position, height and yaw)" in said
    assert "its camera sees no anchors" in said


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_value_that_is_no_number_is_a_mismatch_like_any_other(value: float) -> None:
    parameters = Parameters(PX4, rules_of(PX4, vision=True))
    parameters.hear(ParamValue("EKF2_EV_CTRL", value, 9))
    assert any("EKF2_EV_CTRL is" in text for text in parameters.mismatches(needed=True))


def test_the_nearest_point_of_the_box() -> None:
    assert clamped((9.0, -1.0, 1.5), SPEC.box_m) == (5.0, 0.0, 1.5)
