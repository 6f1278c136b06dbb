"""Whatever is done to a VISCA head in whatever order: judged by what leaves for the wire."""

from __future__ import annotations

import math
from contextlib import suppress

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig_emulators.visca_wire import gathered
from tests.visca_bench import SPEC, ViscaBench

STOP, POSITION = bytes.fromhex("01 06 01"), bytes.fromhex("01 06 02")
HABITS: tuple[dict[str, object], ...] = (
    {},
    {"overtaking": "queue"},
    {"overtaking": "refuse"},
    {"acknowledges": False},
    {"reports": "target"},
)


class ViscaSafety(RuleBasedStateMachine):
    """A head, what a model of it says it may do, and the messages since the last step."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = ViscaBench()
        self.head = self.bench.head
        self.opened = self.allowed = False
        self.seen = 0

    @rule(habit=st.sampled_from(HABITS), seed=st.integers(0, 3))
    @precondition(lambda self: not self.opened and self.seen == 0)
    def another_head(self, habit: dict[str, object], seed: int) -> None:
        self.bench = ViscaBench(seed=seed, **habit)  # type: ignore[arg-type]
        self.head = self.bench.head

    @rule()
    def open(self) -> None:
        with suppress(LinkLost):
            self.head.open()
            self.opened = True

    @rule()
    def enable(self) -> None:
        with suppress(LinkLost):
            self.head.enable()
            self.allowed = True

    @rule(pan_deg=st.floats(-200.0, 200.0) | st.just(math.nan), tilt_deg=st.floats(-120.0, 60.0))
    def move(self, pan_deg: float, tilt_deg: float) -> None:
        before = len(self.bench.transport.wire)
        try:
            self.head.move_to(math.radians(pan_deg), math.radians(tilt_deg))
            assert self.allowed
        except (InputError, NotEnabledError, LinkLost):
            return
        for message in self._since(before):
            if message.startswith(POSITION):
                counts = gathered(message[5:9]), gathered(message[9:13])
                pan, tilt = (math.radians(0.075 * (count or 0)) for count in counts)
                assert SPEC.pan_limits_rad[0] - 1e-9 <= -pan <= SPEC.pan_limits_rad[1] + 1e-9
                assert SPEC.tilt_limits_rad[0] - 1e-9 <= tilt <= SPEC.tilt_limits_rad[1] + 1e-9
        self.seen = len(self.bench.transport.wire)

    @rule()
    def stop(self) -> None:
        self.head.stop()
        self.allowed = False
        if self.opened:
            assert any(message.startswith(STOP) for message in self._since(self.seen))

    @rule()
    def close(self) -> None:
        self.head.close()
        self.opened = self.allowed = False
        motions = [message for message in self._since(0) if message[:2] == STOP[:2]]
        assert not motions or motions[-1].startswith(STOP)

    @rule(duration_s=st.floats(0.0, 2.0))
    def poll(self, duration_s: float) -> None:
        if self.opened:
            try:
                self.bench.poll(duration_s)
            except LinkLost:
                self.close()

    @rule(drops=st.integers(0, 6), silent=st.booleans(), garble=st.sampled_from((0.0, 0.01, 0.3)))
    def trouble(self, drops: int, silent: bool, garble: float) -> None:
        faults = self.bench.line.faults
        faults.drop_next(drops)
        faults.silent = silent
        faults.garble(garble)

    @invariant()
    def nothing_moves_but_by_a_move(self) -> None:
        assert not any(message.startswith(POSITION) for message in self._since(self.seen))
        self.seen = len(self.bench.transport.wire)

    def _since(self, number: int) -> list[bytes]:
        """Return what was sent after so many messages, without addresses."""
        return [message[1:] for _, message in self.bench.transport.wire[number:]]


TestViscaSafety = ViscaSafety.TestCase
TestViscaSafety.settings = settings(max_examples=40, stateful_step_count=25, deadline=None)
