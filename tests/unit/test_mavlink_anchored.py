"""Drones that fly by the anchors their camera sees: what happens when those end, or say other than the estimate."""

from __future__ import annotations

from camrig_drivers.mavlink.fitness import unfit
from camrig_drivers.mavlink.flavours import Flavour
from camrig_drivers.mavlink.frames import Vector
from camrig_drivers.mavlink.phase import Phase
from camrig_drivers.mavlink.section import VehicleSettings
from camrig_drivers.mavlink.watch import Needs
from tests.mavlink_copter import BOTH, SPEC, STEP_S, Flight

HOLD, LAND = Phase.HOLDING, Phase.DESCENDING
VISION = {
    "GPS1_TYPE": 0.0,
    "VISO_TYPE": 1.0,
    **dict.fromkeys(("EK3_SRC1_POSXY", "EK3_SRC1_POSZ", "EK3_SRC1_YAW"), 6.0),
    "EK3_SRC1_VELXY": 0.0,
    "EK3_SRC1_VELZ": 0.0,
    "SYS_HAS_GPS": 0.0,
    "EKF2_GPS_CTRL": 0.0,
    "EKF2_EV_CTRL": 11.0,
    "EKF2_HGT_REF": 3.0,
    "EKF2_MAG_TYPE": 5.0,
}


@BOTH
def test_vision_lost_holds_then_lands_while_telemetry_claims_all_is_well(flavour: Flavour) -> None:
    """Measured: the estimate stands where it was for 8 s while the drone drifts."""
    flight = Flight(flavour, VehicleSettings(needs=Needs(vision=True)), parameters=VISION)
    flight.run(2.0)

    def fly(duration_s: float, *, sees: bool) -> None:
        for _ in range(round(duration_s / STEP_S)):
            if sees:
                flight.vehicle.watch.see_from_outside(flight.copter.position_m, flight.now_s)
            flight.run(STEP_S)

    flight.vehicle.arm(flight.now_s)
    fly(8.0, sees=True)
    assert flight.vehicle.phase is Phase.FLYING
    fly(0.6, sees=False)
    assert flight.vehicle.phase is HOLD
    assert "no pose by anchors" in flight.vehicle.reason
    fly(1.2, sees=False)
    assert flight.vehicle.phase in {Phase.LANDING, LAND}
    fly(3.0, sees=True)  # it comes back: the landing goes on
    assert flight.vehicle.phase in {LAND, Phase.PASSIVE}


def flown_by_vision(flavour: Flavour) -> Flight:
    flight = Flight(flavour, VehicleSettings(needs=Needs(vision=True)), parameters=VISION)
    watched(flight, 2.0)
    assert list(unfit(flight.vehicle, flight.now_s)) == []
    flight.vehicle.arm(flight.now_s)
    watched(flight, 8.0)
    assert flight.vehicle.phase is Phase.FLYING
    return flight


def watched(flight: Flight, duration_s: float, drift_m_s: Vector = (0.0, 0.0, 0.0)) -> None:
    """Let time go by while anchors show where it truly is; its estimate leaves the truth by and by."""
    for _ in range(round(duration_s / STEP_S)):
        flight.vehicle.watch.see_from_outside(flight.copter.position_m, flight.now_s)
        drift = [a + b * STEP_S for a, b in zip(flight.copter.bias_m, drift_m_s, strict=True)]
        flight.copter.bias_m = (drift[0], drift[1], drift[2])
        flight.run(STEP_S)


@BOTH
def test_an_estimate_that_leaves_its_anchors_is_landed(flavour: Flavour) -> None:
    """It believes that it hovers in its box, and flies off; its anchors tell."""
    flight = flown_by_vision(flavour)
    watched(flight, 6.0, (0.25, 0.0, 0.0))
    assert "from where its anchors put it: it lands" in flight.vehicle.reason


@BOTH
def test_what_is_outside_its_box_by_its_anchors_is_landed_whatever_it_believes(flavour: Flavour) -> None:
    flight = flown_by_vision(flavour)
    since_s = flight.now_s
    watched(flight, 1.5, (0.0, 0.0, -2.0))
    climbed_m = flight.copter.position_m[2]
    watched(flight, 0.3)
    assert flight.vehicle.phase in {Phase.LANDING, LAND}
    assert 21 in flight.commands(since_s)
    assert climbed_m < SPEC.box_m[1][2] + 2.0


@BOTH
def test_what_stands_elsewhere_than_it_believes_is_not_armed(flavour: Flavour) -> None:
    flight = Flight(flavour, VehicleSettings(needs=Needs(vision=True)), parameters=VISION, bias_m=(0.8, 0.0, 0.0))
    watched(flight, 2.0)
    assert "0.8 m from where its anchors put it" in "; ".join(unfit(flight.vehicle, flight.now_s))
