"""What every head must do, whatever it is made of: one class, run on each.

Angles are far from anything's rounding; nothing here knows how a head talks, except its ``HeadRig``.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
import pytest

from camrig.errors import InputError, LinkLost, NotEnabledError
from camrig.geometry.pan_tilt import PanTilt
from camrig.interfaces import Head
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import driver as pelco_d_driver
from camrig_emulators.fakes import FakeHead
from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine
from tests.uvc_kernel import UvcRig
from tests.visca_rigs import ViscaRawUdpRig, ViscaSerialRig, ViscaUdpRig

SPEC = HeadSpec(
    id="pt1",
    kinematics=PanTilt(np.eye(4)),
    pan_limits_rad=(math.radians(-170.0), math.radians(170.0)),
    tilt_limits_rad=(math.radians(-90.0), math.radians(10.0)),
    speed_rad_s=math.radians(120.0),
)
AIM = (math.radians(5.0), math.radians(-8.0))
FAR = (math.radians(-150.0), math.radians(-80.0))


class HeadRig(Protocol):
    """A head under test, and what an observer at its far end sees."""

    head: Head
    faults: Faults
    guarded: bool
    """Whether a guardian can stop it when the daemon is dead."""

    def orders(self) -> list[str]:
        """Return "move" and "stop" as they arrived."""
        ...

    def true_angles_rad(self) -> tuple[float, float]:
        """Return where it truly points now."""
        ...

    def take_down(self) -> None:
        """End the far end."""
        ...


class FakeRig:
    """The head in memory."""

    guarded = True

    def __init__(self) -> None:
        self.head: Head
        self._fake = self.head = FakeHead(SPEC, exchange_s=0.01)
        self.faults = self._fake.faults

    def orders(self) -> list[str]:
        return ["stop" if aim is None else "move" for _, aim in self._fake.commands]

    def true_angles_rad(self) -> tuple[float, float]:
        return self._fake.true_angles_rad(time.monotonic())

    def take_down(self) -> None:
        self.head.close()


class PelcoDRig:
    """The Pelco-D driver over a pty, with an emulated head at its end."""

    guarded = True

    def __init__(self) -> None:
        self._line = PelcoDLine(
            [PelcoDHeadSettings(id="pt1", baud=19200, max_speed_deg_s=120.0, acceleration_deg_s2=300.0)]
        )
        port = self._line.start()
        section = pelco_d_driver.section(port=port, baud=19200, gap_s=0.01)
        self.head = pelco_d_driver.make({"pt1": (SPEC, section)})["pt1"]
        self.faults = self._line.faults

    def orders(self) -> list[str]:
        return [order for _, frame in self._line.received if (order := self._order(frame))]

    def true_angles_rad(self) -> tuple[float, float]:
        return self._line.true_angles_rad("pt1", time.monotonic())

    def take_down(self) -> None:
        self.head.close()
        self._line.stop()

    @staticmethod
    def _order(frame: bytes) -> str:
        """Anything that is neither a query nor a stop counts as a motion, even if it is none."""
        if frame[2:6] == bytes(4):
            return "stop"
        return "" if frame[2] == 0 and frame[3] in (0x51, 0x53) else "move"


RIGS: dict[str, Callable[[], HeadRig]] = {
    "fake": FakeRig,
    "pelco_d": PelcoDRig,
    "visca": lambda: ViscaSerialRig(SPEC),
    "visca_udp": lambda: ViscaUdpRig(SPEC),
    "visca_raw_udp": lambda: ViscaRawUdpRig(SPEC),
    "uvc": lambda: UvcRig(SPEC),
}


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest) -> Iterator[HeadRig]:
    rig = RIGS[request.param]()
    yield rig
    rig.take_down()


def _until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 3.0
    while not condition():
        assert time.monotonic() < deadline_s, "waited for 3 s"
        time.sleep(0.005)


def _lose(rig: HeadRig) -> None:
    """Unplug, and read until the head notices."""
    rig.faults.unplug()
    with pytest.raises(LinkLost):
        _read_for(rig.head, 3.0)


def _read_for(head: Head, duration_s: float) -> None:
    deadline_s = time.monotonic() + duration_s
    while time.monotonic() < deadline_s:
        head.read(0.5)


def _reopen(rig: HeadRig) -> None:
    """Replug, and open as a worker does: again until the port is back."""
    rig.head.close()
    rig.faults.replug()
    deadline_s = time.monotonic() + 3.0
    while True:
        try:
            return rig.head.open()
        except LinkLost:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


def _orders_heard(rig: HeadRig) -> list[str]:
    """Return the orders of an open head; one that has answered has heard everything sent before."""
    assert len(rig.head.read(1.0)) == 2
    return rig.orders()


def _last_order(rig: HeadRig) -> str:
    """Return the last order of a closed head, once nothing more comes."""
    _until(lambda: "stop" in rig.orders())
    time.sleep(0.1)
    return rig.orders()[-1]


class TestHead:
    """The contract of camrig.interfaces.Head."""

    def test_building_and_opening_order_nothing(self, rig: HeadRig) -> None:
        before = rig.true_angles_rad()
        rig.head.open()
        assert _orders_heard(rig) == []
        assert rig.true_angles_rad() == before

    def test_enabling_orders_nothing(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        assert _orders_heard(rig) == []

    def test_nothing_moves_before_enable(self, rig: HeadRig) -> None:
        rig.head.open()
        with pytest.raises(NotEnabledError):
            rig.head.move_to(*AIM)
        assert _orders_heard(rig) == []

    def test_an_enabled_head_goes_where_it_is_sent(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.move_to(*AIM)
        _until(lambda: rig.true_angles_rad() == pytest.approx(AIM, abs=1e-3))

    def test_move_to_does_not_wait_for_the_motion(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        begun_s = time.monotonic()
        rig.head.move_to(*FAR)
        assert time.monotonic() - begun_s < 0.3
        assert rig.true_angles_rad() != pytest.approx(FAR, abs=0.1)

    def test_stop_ends_the_motion(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.move_to(*FAR)
        _until(lambda: abs(rig.true_angles_rad()[0]) > 0.05)
        rig.head.stop()
        time.sleep(0.5)
        at_rest = rig.true_angles_rad()
        time.sleep(0.1)
        assert rig.true_angles_rad() == pytest.approx(at_rest, abs=1e-6)
        assert abs(at_rest[0]) < abs(FAR[0]) / 2.0

    def test_stop_disables(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.stop()
        with pytest.raises(NotEnabledError):
            rig.head.move_to(*AIM)
        assert set(_orders_heard(rig)) == {"stop"}

    def test_enable_after_stop_allows_motion_again(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.stop()
        rig.head.enable()
        rig.head.move_to(*AIM)
        _until(lambda: rig.true_angles_rad() == pytest.approx(AIM, abs=1e-3))

    def test_stop_works_in_every_state(self, rig: HeadRig) -> None:
        rig.head.stop()
        rig.head.open()
        rig.head.stop()
        rig.head.enable()
        rig.head.stop()
        rig.head.stop()
        rig.head.close()
        rig.head.stop()
        assert set(rig.orders()) <= {"stop"}

    def test_stop_from_any_thread_while_another_reads_and_moves(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        refused = threading.Event()

        def work() -> None:
            try:
                for turn in range(1000):
                    rig.head.read(1.0)
                    rig.head.move_to(AIM[0] + 0.01 * (turn % 2), AIM[1])
            except NotEnabledError:
                refused.set()

        worker = threading.Thread(target=work, name="head worker")
        worker.start()
        _until(lambda: "move" in rig.orders())
        rig.head.stop()
        worker.join(3.0)
        assert refused.is_set()
        assert _orders_heard(rig)[-1] == "stop"

    @pytest.mark.parametrize(
        "outside_deg", [(171.0, -30.0), (-170.1, -30.0), (20.0, 10.1), (20.0, -91.0), (math.nan, 0.0), (0.0, math.inf)]
    )
    def test_outside_the_limits_nothing_is_ordered(self, rig: HeadRig, outside_deg: tuple[float, float]) -> None:
        rig.head.open()
        rig.head.enable()
        with pytest.raises(InputError, match="pt1"):
            rig.head.move_to(math.radians(outside_deg[0]), math.radians(outside_deg[1]))
        assert _orders_heard(rig) == []

    def test_the_limits_themselves_are_allowed(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.move_to(SPEC.pan_limits_rad[1], SPEC.tilt_limits_rad[0])
        rig.head.move_to(SPEC.pan_limits_rad[0], SPEC.tilt_limits_rad[1])
        _until(lambda: "move" in rig.orders())

    def test_read_gives_each_axis_a_stamp_and_its_sigmas(self, rig: HeadRig) -> None:
        rig.head.open()
        begun_s = time.monotonic()
        readings = rig.head.read(1.0)
        ended_s = time.monotonic()
        assert {(reading.head_id, reading.axis) for reading in readings} == {("pt1", "pan"), ("pt1", "tilt")}
        for reading, true_rad in zip(readings, rig.true_angles_rad(), strict=True):
            assert begun_s <= reading.stamp_s <= ended_s
            assert 0.0 < reading.sigma_rad < 0.01
            assert reading.stamp_sigma_s >= 0.0
            assert abs(reading.angle_rad - true_rad) <= 3.0 * reading.sigma_rad

    def test_a_head_that_does_not_answer_is_not_guessed(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.faults.silent = True
        assert rig.head.read(0.2) == ()

    def test_a_lost_link_is_raised_by_all_but_stop_and_close(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        _lose(rig)
        with pytest.raises(LinkLost):
            rig.head.move_to(*AIM)
        rig.head.stop()
        rig.head.close()

    def test_after_a_lost_link_nothing_is_replayed(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.move_to(*FAR)
        _lose(rig)
        before = len(rig.orders())
        _reopen(rig)
        with pytest.raises(NotEnabledError):
            rig.head.move_to(*AIM)
        assert len(rig.head.read(1.0)) == 2
        assert "move" not in rig.orders()[before:]

    def test_reopening_moves_again_once_enabled(self, rig: HeadRig) -> None:
        rig.head.open()
        _lose(rig)
        _reopen(rig)
        rig.head.enable()
        rig.head.move_to(*AIM)
        _until(lambda: rig.true_angles_rad() == pytest.approx(AIM, abs=1e-3))

    def test_closing_an_enabled_head_stops_it_last(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.move_to(*AIM)
        rig.head.close()
        rig.head.close()
        assert _last_order(rig) == "stop"

    def test_closing_a_head_nobody_enabled_orders_nothing(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.close()
        rig.head.close()
        time.sleep(0.1)
        assert rig.orders() == []

    def test_a_closed_head_opens_disabled(self, rig: HeadRig) -> None:
        rig.head.open()
        rig.head.enable()
        rig.head.close()
        rig.head.open()
        with pytest.raises(NotEnabledError):
            rig.head.move_to(*AIM)

    def test_a_guard_is_valid_while_open(self, rig: HeadRig) -> None:
        rig.head.open()
        guard = rig.head.guard()
        assert (guard.fd >= 0 and bool(guard.stop_bytes)) == rig.guarded
        rig.head.close()
        with pytest.raises(LinkLost):
            rig.head.guard()
