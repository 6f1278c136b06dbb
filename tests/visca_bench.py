"""The VISCA driver and an emulated line in one thread and in simulated time: whoever waits moves the clock."""

from __future__ import annotations

import math

import numpy as np

from camrig.clock import ManualClock
from camrig.geometry.pan_tilt import PanTilt
from camrig.rig import HeadSpec
from camrig_drivers.visca.codec import Splitter, parse
from camrig_drivers.visca.head import ViscaHead
from camrig_drivers.visca.line import Line
from camrig_drivers.visca.section import ViscaSection
from camrig_drivers.visca.transport import Heard, Sent
from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine

SPEC = HeadSpec(
    id="pt1",
    kinematics=PanTilt(np.eye(4)),
    pan_limits_rad=(math.radians(-170.0), math.radians(170.0)),
    tilt_limits_rad=(math.radians(-90.0), math.radians(30.0)),
    speed_rad_s=math.radians(40.0),
)
AXES = {"pan": {"deg_per_count": 0.075, "sign": -1}, "tilt": {"deg_per_count": 0.075, "sign": 1}}


class SteppedClock(ManualClock):
    """A clock that sleepers move."""

    def sleep_s(self, duration_s: float) -> None:
        self.advance(max(0.0, duration_s))


class SteppedTransport:
    """A serial line whose far end is an emulated one that nobody else runs."""

    name = "stepped"
    fd = 0

    def __init__(self, emulated: ViscaLine, clock: SteppedClock, baud: int) -> None:
        self.cut = False
        """Whether the cable is cut: what is sent is lost."""
        self.wire: list[tuple[float, bytes]] = []
        """What was sent, and when its first bit left."""
        self._emulated = emulated
        self._clock = clock
        self._baud = baud
        self._splitter = Splitter()
        self._heard: list[Heard] = []

    def send(self, message: bytes) -> Sent:
        self.wire.append((self._clock.now_s(), message))
        if not self.cut:
            self._emulated.receive(message, self._clock.now_s(), self._baud)
        return Sent(self._clock.now_s() + len(message) * 10.0 / self._baud)

    def receive(self, timeout_s: float) -> list[Heard]:
        until_s = self._clock.now_s() + timeout_s
        while not self._heard:
            next_s = self._emulated.next_s()
            if next_s is None or next_s > until_s:
                self._clock.sleep_s(until_s - self._clock.now_s())
                break
            self._clock.sleep_s(next_s - self._clock.now_s())
            now_s = self._clock.now_s()
            for raw in self._splitter.feed(self._emulated.transmit(now_s, self._baud)):
                if reply := parse(raw):
                    self._heard.append(Heard(reply, now_s - len(raw) * 10.0 / self._baud, now_s))
        heard, self._heard = self._heard, []
        return heard

    def guard_bytes(self, stop: bytes, cancels: object) -> bytes:
        del cancels
        return stop

    def wake(self) -> None:
        """Do nothing: there is one thread."""

    def close(self) -> None:
        """Do nothing: there is no port."""


class ViscaBench:
    """One driver and its emulated head."""

    def __init__(
        self,
        *,
        seed: int = 0,
        baud: int = 9600,
        readback_sigma_deg: float = 0.02,
        zoom: int | None = None,
        **emulated: object,
    ) -> None:
        self.clock = SteppedClock()
        settings = ViscaHeadSettings.model_validate({"id": "pt1", "baud": baud, **emulated})
        self.line = ViscaLine([settings], clock=self.clock, seed=seed)
        self.transport = SteppedTransport(self.line, self.clock, baud)
        section = ViscaSection.model_validate(
            {"port": "/dev/none", "baud": baud, "axes": AXES, "readback_sigma_deg": readback_sigma_deg, "zoom": zoom}
        )
        line = Line(lambda: self.transport, self.clock, reply_timeout_s=0.2, gap_s=0.02)
        self.head = ViscaHead(SPEC, section, line, self.clock)

    def truth_rad(self, stamp_s: float | None = None) -> tuple[float, float]:
        return self.line.true_angles_rad("pt1", self.clock.now_s() if stamp_s is None else stamp_s)

    def poll(self, duration_s: float) -> list[tuple[float, float, float, float]]:
        """Read for so long; return (stamp_s, error in pan, error in tilt, sigma) of every reading, in radians."""
        found = []
        until_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < until_s:
            if readings := self.head.read(0.3):
                true = self.truth_rad(readings[0].stamp_s)
                pan, tilt = (reading.angle_rad - angle for reading, angle in zip(readings, true, strict=True))
                found.append((readings[0].stamp_s, pan, tilt, readings[0].sigma_rad))
        return found
