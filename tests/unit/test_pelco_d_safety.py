"""Whatever is done with a head in whatever order: nothing moves unasked, and nothing leaves its limits."""

import math
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from camrig.errors import InputError, LinkLost, NotEnabledError
from tests.simulated_line import PAN_DEG, TILT_DEG, SimulatedHeads

ANGLES = st.floats(-400.0, 400.0) | st.sampled_from([-170.0, 170.0, math.nan, math.inf])
INSIDE = st.tuples(st.floats(*PAN_DEG), st.floats(*TILT_DEG))
_SPEEDS = {"speeds": {1: 40.0 / 63.0, 63: 40.0}}
_COAST_DEG = 0.2
_PRESET: dict[str, Any] = {
    "by": "preset",
    "preset": 1,
    "pan_deg": 0.0,
    "tilt_deg": 0.0,
    "travel_s": 6.0,
    "sigma_deg": 0.05,
}
_OPEN_LOOP = {"zero": _PRESET, "start_s": 0.05, "start_sigma_s": 0.0, "stop_sigma_s": 0.0, "speed_sigma": 0.02}
_STORE_PRESET = bytes.fromhex("ff010003000105")


class HeadMachine(RuleBasedStateMachine):
    """A head, its line, and an operator who does anything at any time."""

    rig: SimulatedHeads

    @initialize(
        grade=st.sampled_from(["absolute", "velocity", "open_loop"]),
        play=st.sampled_from([0.0, 0.3]),
        seed=st.integers(0, 9),
    )
    def begin(self, grade: str, play: float, seed: int) -> None:
        axis: dict[str, Any] = {**_SPEEDS, "backlash_deg": play}
        keys: dict[str, Any] = {"grade": grade, "axes": {"pan": axis, "tilt": axis}}
        self.rig = SimulatedHeads(
            keys={**keys, "open_loop": _OPEN_LOOP} if grade == "open_loop" else keys, seed=seed, backlash_deg=play
        )
        self.rig.line.receive(_STORE_PRESET, self.rig.time.now_s(), 9600)
        self.rig.time.sleep_s(0.5)
        self.rig.truth_deg()
        self.reckoned = grade == "open_loop"
        self.by_speeds = grade != "absolute"
        self.may_move = False
        self.is_open = False
        self.stopped_at: int | None = len(self.rig.motions())

    @rule()
    def open(self) -> None:
        try:
            self.rig.head.open()
            self.is_open = True
        except LinkLost:
            self.is_open = self.may_move = False

    @rule()
    def enable(self) -> None:
        try:
            self.rig.head.enable()
            self.may_move, self.stopped_at = True, None
        except LinkLost:
            assert not self.is_open

    @rule(angles_deg=INSIDE | st.tuples(ANGLES, ANGLES))
    def move(self, angles_deg: tuple[float, float]) -> None:
        pan_deg, tilt_deg = angles_deg
        inside = PAN_DEG[0] <= pan_deg <= PAN_DEG[1] and TILT_DEG[0] <= tilt_deg <= TILT_DEG[1]
        try:
            self.rig.move(pan_deg, tilt_deg)
            assert inside
            assert self.may_move
        except InputError:
            assert not inside
        except NotEnabledError:
            assert not self.may_move
        except LinkLost:
            pass

    @rule(seconds=st.floats(0.05, 3.0))
    def read(self, seconds: float) -> None:
        try:
            readings = self.rig.poll(seconds)
            if self.reckoned:  # by what it was told, stops above all; the other grades are asked
                assert self.rig.worst_error_deg(readings) <= _COAST_DEG
        except LinkLost:
            self.close()

    @rule(angles_deg=INSIDE, seconds=st.floats(1.0, 9.0))
    def work(self, angles_deg: tuple[float, float], seconds: float) -> None:
        """Do what a daemon does; long enough for an open-loop head to have zeroed itself and be on its way."""
        self.open()
        self.enable()
        self.move(angles_deg)
        self.read(seconds)

    @rule()
    def stop(self) -> None:
        self.rig.head.stop()
        self.may_move = False
        self.settle()
        if self.is_open:
            self.read(0.5)

    @rule()
    def close(self) -> None:
        self.rig.head.close()
        self.is_open = self.may_move = False
        self.settle()

    def settle(self) -> None:
        """Let what is on the wire arrive; from here on until the next enable nothing but stops may come."""
        self.rig.time.sleep_s(0.4)
        self.rig.truth_deg()
        self.stopped_at = len(self.rig.motions())

    @rule(fault=st.sampled_from(["silent", "echo", "stuck", "splits"]), on=st.booleans())
    def fault(self, fault: str, on: bool) -> None:
        if not (self.by_speeds and fault == "stuck"):  # driven by speeds, it goes on where no stop can be sent
            setattr(self.rig.line.faults, fault, on)

    @rule(plugged=st.booleans())
    def plug(self, plugged: bool) -> None:
        if plugged or not self.by_speeds:
            (self.rig.line.faults.replug if plugged else self.rig.line.faults.unplug)()

    @invariant()
    def nothing_moves_unasked(self) -> None:
        if self.stopped_at is not None:
            assert set(self.rig.motions()[self.stopped_at :]) <= {"stop"}

    @invariant()
    def nothing_leaves_its_limits(self) -> None:
        pan_deg, tilt_deg = self.rig.truth_deg()
        assert PAN_DEG[0] - _COAST_DEG <= pan_deg <= PAN_DEG[1] + _COAST_DEG
        assert TILT_DEG[0] - _COAST_DEG <= tilt_deg <= TILT_DEG[1] + _COAST_DEG

    def teardown(self) -> None:
        if not hasattr(self, "rig"):
            return
        self.rig.line.faults.clear()
        self.rig.head.close()
        self.rig.time.sleep_s(1.0)
        self.rig.truth_deg()


TestHead = HeadMachine.TestCase
TestHead.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
