"""A USB camera on a pan-tilt head as the kernel shows it: controls that move, on ``v4l2_kernel``'s device."""

from __future__ import annotations

import errno
import math
import struct
import threading

from camrig.clock import Clock, RealClock
from camrig.interfaces import Head
from camrig.rig import HeadSpec
from camrig_drivers.uvc import UvcHead, UvcSection
from camrig_emulators.faults import Faults
from camrig_emulators.pelco_d_motion import AxisMotion
from tests.v4l2_control_bank import INTEGER, USUAL_CONTROLS, Argument, Control, ControlBank
from tests.v4l2_kernel import PATH, FakeKernel, Habits

PAN, TILT, ZOOM, PAN_SPEED, TILT_SPEED = 0x9A0908, 0x9A0909, 0x9A090D, 0x9A0920, 0x9A0921
DEGREE = 3600


def ptz_controls(step: int, *, speeds: bool = False) -> tuple[Control, ...]:
    """Return pan +-170, tilt -90 to +30 deg, in seconds of arc, and zoom 100 to 500."""
    controls = (
        Control(PAN, "Pan, Absolute", INTEGER, -170 * DEGREE, 170 * DEGREE, step),
        Control(TILT, "Tilt, Absolute", INTEGER, -90 * DEGREE, 30 * DEGREE, step),
        Control(ZOOM, "Zoom, Absolute", INTEGER, 100, 500, value=100),
    )
    more = (Control(PAN_SPEED, "Pan, Speed", INTEGER, -1, 1), Control(TILT_SPEED, "Tilt, Speed", INTEGER, -1, 1))
    return (*controls, *more) if speeds else controls


class PtzBank(ControlBank):
    """Controls of which pan and tilt are motors. ``reports_target``: they hold where they are going to."""

    def __init__(
        self, controls: tuple[Control, ...], clock: Clock, *, speed_deg_s: float, reports_target: bool
    ) -> None:
        self.faults = Faults()
        self.orders: list[str] = []
        self._clock = clock
        self._reports_target = reports_target
        self._steps = {control.id: control.step for control in controls}
        self._speed = speed_deg_s * DEGREE
        self._motions = {control.id: self._motor(control) for control in controls if control.id in {PAN, TILT}}
        self._bank_lock = threading.Lock()
        super().__init__(controls, ())

    def reset(self) -> None:
        """Keep the motors where they are: only a camera without power forgets, and this one is only unplugged."""
        if not hasattr(self, "_values"):
            super().reset()

    def _motor(self, control: Control) -> AxisMotion:
        limits = (control.low, control.high)
        return AxisMotion(0.0, limits=limits, speed=self._speed, acceleration=400.0 * DEGREE)

    def come_back_at_home(self) -> None:
        """Lose power: everything is as it was first, the motors at zero."""
        super().reset()
        self._motions = {control.id: self._motor(control) for control in self.controls if control.id in {PAN, TILT}}

    def angle_deg(self, control_id: int) -> float:
        return self._motions[control_id].motor(self._clock.now_s()) / DEGREE

    def get(self, data: Argument) -> int:
        if self.faults.silent:
            return errno.ETIMEDOUT
        control, memory = self._one_control(data)
        if control.id not in self._motions:
            return super().get(data)
        with self._bank_lock:
            position = self._motions[control.id].motor(self._clock.now_s())
            step = self._steps[control.id]
            held = self._values[control.id] if self._reports_target else round(position / step) * step
        struct.pack_into("<i", memory, 12, held)
        return 0

    def set(self, data: Argument) -> int:
        control, memory = self._one_control(data)
        error = super().set(data)
        if error:
            return error
        (value,) = struct.unpack_from("<i", memory, 12)
        now_s = self._clock.now_s()
        with self._bank_lock:
            if control.id in {PAN_SPEED, TILT_SPEED} and value == 0:
                self._motions[PAN if control.id == PAN_SPEED else TILT].stop(now_s)
            elif control.id in self._motions:
                motion = self._motions[control.id]
                self.orders.append("stop" if abs(value - motion.motor(now_s)) <= 1.5 * DEGREE else "move")
                motion.go_to(value, now_s)
        return 0


class PtzKernel(FakeKernel):
    """The device: a camera and its head."""

    def __init__(
        self,
        clock: Clock,
        *,
        step: int = DEGREE,
        speed_deg_s: float = 40.0,
        reports_target: bool = True,
        speeds: bool = False,
    ) -> None:
        controls = ptz_controls(step, speeds=speeds)
        super().__init__(Habits(formats={"GREY": ((32, 24),)}, controls=(*USUAL_CONTROLS, *controls)))
        self.bank = PtzBank(self.habits.controls, clock, speed_deg_s=speed_deg_s, reports_target=reports_target)
        self.controls = self.bank
        self.bank.faults.watch(self._follow)

    def angles_rad(self) -> tuple[float, float]:
        """Return where it looks, as camrig says it: pan positive to the left."""
        return math.radians(-self.bank.angle_deg(PAN)), math.radians(self.bank.angle_deg(TILT))

    def _follow(self) -> None:
        (self.replug if self.bank.faults.plugged else self.unplug)()


class UvcRig:
    """The UVC driver on such a device, for the contract of heads: see contract/test_head_contract."""

    guarded = False

    def __init__(self, spec: HeadSpec) -> None:
        self.clock = RealClock()
        self.kernel = PtzKernel(self.clock, step=36, speed_deg_s=120.0, reports_target=False)
        section = UvcSection(device=PATH, reports="position", poll_s=0.01)
        self.head: Head = UvcHead(spec, section, self.clock, self.kernel)
        self.faults = self.kernel.bank.faults

    def orders(self) -> list[str]:
        return list(self.kernel.bank.orders)

    def true_angles_rad(self) -> tuple[float, float]:
        return self.kernel.angles_rad()

    def take_down(self) -> None:
        self.head.close()
        assert self.kernel.free
