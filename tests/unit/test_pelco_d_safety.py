"""Whatever is done with a head in whatever order: nothing moves unasked, and nothing leaves its limits."""

import math
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from camrig.errors import InputError, LinkLost, NotEnabledError
from tests.simulated_line import PAN_DEG, TILT_DEG, SimulatedHeads

ANGLES = st.floats(-400.0, 400.0) | st.sampled_from([-170.0, 170.0, math.nan, math.inf])
_SPEEDS = {"speeds": {1: 40.0 / 63.0, 63: 40.0}}
_COAST_DEG = 0.2


class HeadMachine(RuleBasedStateMachine):
    """A head, its line, and an operator who does anything at any time."""

    rig: SimulatedHeads

    @initialize(
        grade=st.sampled_from(["absolute", "velocity"]), play=st.sampled_from([0.0, 0.3]), seed=st.integers(0, 9)
    )
    def begin(self, grade: str, play: float, seed: int) -> None:
        axis: dict[str, Any] = {**_SPEEDS, "backlash_deg": play}
        keys = {"grade": grade, "axes": {"pan": axis, "tilt": axis}}
        self.rig = SimulatedHeads(keys=keys, seed=seed, backlash_deg=play)
        self.may_move = False
        self.is_open = False
        self.stopped_at: int | None = 0

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

    @rule(pan_deg=ANGLES, tilt_deg=ANGLES)
    def move(self, pan_deg: float, tilt_deg: float) -> None:
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
            self.rig.poll(seconds)
        except LinkLost:
            self.close()

    @rule()
    def stop(self) -> None:
        self.rig.head.stop()
        self.may_move = False
        self.settle()

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
        setattr(self.rig.line.faults, fault, on)

    @rule(plugged=st.booleans())
    def plug(self, plugged: bool) -> None:
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
