"""A head inside a USB camera, on a simulated kernel and in simulated time."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
import pytest

from camrig.errors import HardwareError, LinkLoss, LinkLost
from camrig.geometry.lens import BrownLens
from camrig.rig import CameraSpec, FixedMount, HeadSpec
from camrig_drivers.uvc import UvcHead, UvcSection, driver
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from tests.uvc_kernel import PtzKernel
from tests.v4l2_control_bank import USUAL_CONTROLS, ControlBank
from tests.v4l2_kernel import MONOTONIC, PATH, S_EXT_CTRLS, FakeKernel
from tests.visca_bench import SPEC, SteppedClock

AIM = (math.radians(60.0), math.radians(-30.0))
STEP_RAD = math.radians(1.0)


class Bench:
    """A head and its device on one clock that sleepers move."""

    def __init__(self, *, reports: str = "target", spec: HeadSpec = SPEC, **device: object) -> None:
        self.clock = SteppedClock(100.0)
        self.kernel = PtzKernel(self.clock, reports_target=reports == "target", **device)  # type: ignore[arg-type]
        section = UvcSection.model_validate({"device": PATH, "reports": reports})
        self.head = UvcHead(spec, section, self.clock, self.kernel)

    def enabled(self) -> Bench:
        self.head.open()
        self.head.enable()
        return self

    def poll(self, duration_s: float) -> list[float]:
        """Read for so long; return how far each reading was off, in sigmas."""
        off, until_s = [], self.clock.now_s() + duration_s
        while self.clock.now_s() < until_s:
            for reading, true_rad in zip(self.head.read(0.3), self.kernel.angles_rad(), strict=False):
                off.append(abs(reading.angle_rad - true_rad) / reading.sigma_rad)
        return off


@pytest.mark.parametrize("reports", ["target", "position"])
def test_it_goes_where_it_is_sent_to_within_a_step_and_is_never_said_to_be_elsewhere(reports: str) -> None:
    bench = Bench(reports=reports).enabled()
    off = []
    for aim in (AIM, (-2.0, 0.2), (0.3, -1.5)):
        bench.head.move_to(*aim)
        off += bench.poll(6.0)
        assert bench.kernel.angles_rad() == pytest.approx(aim, abs=0.51 * STEP_RAD)
    bench.head.close()
    assert len(off) > 60
    assert max(off) < 3.0


def test_a_device_that_holds_its_target_is_unknown_until_it_must_be_there() -> None:
    bench = Bench().enabled()
    assert bench.poll(0.2)
    bench.head.move_to(*AIM)
    assert bench.poll(1.9) == []  # 60 deg at 40 deg/s, and half a second to settle
    assert bench.poll(0.5)
    bench.head.close()


@pytest.mark.parametrize(
    ("reports", "speeds"),
    [("target", False), ("position", False), ("target", True)],
    ids=["target", "position", "speeds"],
)
def test_a_stop_ends_a_motion_near_where_it_is(reports: str, speeds: bool) -> None:
    bench = Bench(reports=reports, speeds=speeds).enabled()
    bench.head.move_to(2.9, -1.0)
    bench.poll(1.0)
    at_stop = bench.kernel.angles_rad()
    bench.head.stop()
    bench.poll(5.0)
    assert bench.kernel.angles_rad() == pytest.approx(at_stop, abs=math.radians(8.0))
    assert max(bench.poll(0.5)) < 3.0
    bench.head.close()


def test_limits_are_never_left_by_rounding_to_a_step() -> None:
    spec = HeadSpec("pt1", SPEC.kinematics, (-0.501, 0.501), (-0.301, 0.101), 0.7)
    bench = Bench(spec=spec).enabled()
    for pan_rad in (-0.501, 0.501):
        for tilt_rad in (-0.301, 0.101):
            bench.head.move_to(pan_rad, tilt_rad)
            bench.poll(4.0)
            pan, tilt = bench.kernel.angles_rad()
            assert abs(pan) <= 0.501
            assert -0.301 <= tilt <= 0.101
    bench.head.close()


def test_the_camera_streams_while_its_head_is_opened_moved_and_closed() -> None:
    lens = BrownLens((32, 24), (40.0, 40.0), (16.0, 12.0), (0.0, 0.0, 0.0, 0.0, 0.0))
    bench = Bench()
    camera = V4l2Camera(
        CameraSpec("north", lens, FixedMount(np.eye(4))),
        V4l2Section(device=PATH, format="GREY"),
        bench.clock,
        bench.kernel,
    )
    with ExitStack() as undo:
        undo.callback(camera.close)
        camera.open()
        bench.enabled()
        bench.head.move_to(*AIM)
        bench.poll(3.0)
        bench.head.close()
        assert bench.kernel.expose(bytes(32 * 24), bench.clock.now_s(), MONOTONIC)
        assert camera.read(0.1) is not None
    assert bench.kernel.angles_rad() == pytest.approx(AIM, abs=STEP_RAD)


def test_the_zoom_of_the_calibration_is_set_with_the_first_move_and_not_before() -> None:
    bench = Bench()
    section = UvcSection(device=PATH, zoom=300)
    head = UvcHead(SPEC, section, bench.clock, bench.kernel)
    head.open()
    head.enable()
    assert bench.kernel.bank.held("Zoom, Absolute") == 100
    head.move_to(*AIM)
    assert bench.kernel.bank.held("Zoom, Absolute") == 300
    head.close()


@pytest.mark.parametrize(
    ("kernel", "section", "spec", "says"),
    [
        (lambda _: FakeKernel(), {}, SPEC, "has no control pan_absolute: it is no pan-tilt head"),
        (PtzKernel, {"zoom": 900}, SPEC, "zooms from 100 to 500; zoom 900 is not possible"),
        (
            PtzKernel,
            {},
            HeadSpec("pt1", SPEC.kinematics, (-3.0, 3.1), SPEC.tilt_limits_rad, 1.0),
            "moves its pan from -170 to 170 deg, and pan_deg -171.887 to 177.617 reaches beyond; narrow it",
        ),
    ],
)
def test_a_device_that_cannot_do_what_is_asked_is_refused(
    kernel: Callable[[SteppedClock], FakeKernel], section: dict[str, object], spec: HeadSpec, says: str
) -> None:
    clock = SteppedClock()
    device = kernel(clock)
    head = UvcHead(spec, UvcSection.model_validate({"device": PATH, **section}), clock, device)
    with pytest.raises(HardwareError, match=says):
        head.open()
    assert device.free


@pytest.mark.parametrize("path", ["/dev/none/such", "/dev/null"])
def test_a_device_that_cannot_be_opened_is_told_in_a_sentence(path: str) -> None:
    head = driver.make({"pt1": (SPEC, UvcSection(device=path))})["pt1"]
    with pytest.raises(HardwareError, match=f"head pt1: {path} (does not exist|is no V4L2 camera)"):
        head.open()


def test_what_a_device_refuses_to_set_is_a_lost_link_and_its_silence_too() -> None:
    bench = Bench().enabled()
    bench.kernel.faults[S_EXT_CTRLS] = errno.EIO
    with pytest.raises(LinkLost, match="failed with EIO"):
        bench.head.move_to(*AIM)
    bench.kernel.bank.faults.silent = True
    with pytest.raises(LinkLost, match="ETIMEDOUT"):
        bench.poll(2.0)
    bench.head.close()


def test_one_that_comes_back_is_not_sent_to_where_it_was_going() -> None:
    bench = Bench().enabled()
    bench.head.move_to(*AIM)
    bench.kernel.unplug()
    with pytest.raises(LinkLost):
        bench.head.read(0.1)
    bench.head.close()
    bench.kernel.bank.come_back_at_home()
    bench.kernel.replug()
    bench.head.open()
    assert bench.kernel.bank.orders == ["move", "move"]
    assert bench.kernel.angles_rad() == (0.0, 0.0)
    bench.head.close()


@pytest.mark.parametrize("device", [PATH, "serial=5A17"])
def test_it_is_found_again_under_another_number(device: str) -> None:
    clock = SteppedClock(100.0)
    kernel = PtzKernel(clock)
    kernel.serial = "5A17"
    head = UvcHead(SPEC, UvcSection(device=device), clock, kernel)
    head.open()
    kernel.unplug()
    with pytest.raises(LinkLost):
        head.read(0.1)
    head.close()
    kernel.path = "/dev/video7"
    kernel.replug()
    head.open()
    assert len(head.read(0.1)) == 2
    head.close()


def test_one_that_comes_back_as_something_else_is_a_lost_link() -> None:
    bench = Bench().enabled()
    bench.kernel.unplug()
    with pytest.raises(LinkLost):
        bench.head.read(0.1)
    bench.head.close()
    controls, bench.kernel.controls = bench.kernel.controls, ControlBank(USUAL_CONTROLS, ())
    bench.kernel.replug()
    with pytest.raises(LinkLost, match="has no control pan_absolute") as lost:
        bench.head.open()
    assert lost.value.loss is LinkLoss.CHANGED
    bench.kernel.controls = controls
    bench.head.open()
    bench.head.close()


def test_one_that_kept_its_power_is_stopped_where_it_is() -> None:
    bench = Bench().enabled()
    bench.head.move_to(*AIM)
    bench.poll(0.4)
    bench.kernel.unplug()
    with pytest.raises(LinkLost):
        bench.head.read(0.1)
    bench.head.close()
    bench.kernel.replug()
    bench.head.open()
    here_rad = bench.kernel.angles_rad()
    bench.clock.sleep_s(5.0)
    assert bench.kernel.angles_rad() == pytest.approx(here_rad, abs=math.radians(5.0))
    assert here_rad != pytest.approx(AIM, abs=math.radians(15.0))
    bench.head.close()


@pytest.mark.parametrize("reports", ["target", "position"])
def test_a_stop_moves_nothing_not_even_into_the_limits(reports: str) -> None:
    spec = HeadSpec("pt1", SPEC.kinematics, (math.radians(20.0), math.radians(60.0)), SPEC.tilt_limits_rad, 1.0)
    bench = Bench(reports=reports, spec=spec)
    bench.head.open()
    bench.head.stop()
    bench.clock.sleep_s(5.0)
    assert bench.kernel.angles_rad() == (0.0, 0.0)
    assert "move" not in bench.kernel.bank.orders
    bench.head.close()


def test_two_heads_on_one_device_are_refused() -> None:
    sections = {name: (SPEC, UvcSection(device="/dev/video0")) for name in ("a", "b")}
    assert driver.check is not None
    assert driver.check(sections) == [("b", "device", "/dev/video0 is already the device of head a")]
