"""The real driver on an emulated line in simulated time: no pty, no sleep, every run the same."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from camrig.errors import LinkLost
from camrig.geometry.pan_tilt import PanTilt
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import buses_for
from camrig_drivers.pelco_d.bus import Bus
from camrig_drivers.pelco_d.head import PelcoDHead
from camrig_drivers.pelco_d.section import PelcoDSection
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine
from tests.simulated_time import SimulatedTime

PAN_DEG, TILT_DEG = (-170.0, 170.0), (-90.0, 10.0)
SPEED_DEG_S = 40.0


@dataclass
class Service:
    """What came of serving a head: readings, when it was opened and lost, and why."""

    readings: list[AxisReading] = field(default_factory=list)
    opened_s: list[float] = field(default_factory=list)
    losses: list[tuple[float, str]] = field(default_factory=list)
    aimed_s: list[float] = field(default_factory=list)


class SimulatedPort:
    """What ``camrig_drivers.serial_port.Port`` is over a device file, over a stepped line."""

    def __init__(self, rig: SimulatedHeads, path: str, baud: int) -> None:
        self.path = path
        self._rig = rig
        self._baud = baud
        self._heard = bytearray()
        self._woken = False
        self.is_open = True
        self._require_line("cannot open")

    @property
    def fd(self) -> int:
        self._require_line("closed:")
        return 0

    def write(self, frame: bytes) -> None:
        self._require_line("lost while writing")
        if self._rig.line.faults.stuck:
            self._rig.time.sleep_s(0.5)
            raise LinkLost(f"serial port {self.path} was lost while writing: write timeout")
        self._rig.line.receive(frame, self._rig.time.now_s(), self._baud)

    def read(self, size: int, timeout_s: float) -> bytes:
        until_s = self._rig.time.now_s() + timeout_s
        while True:
            self._require_line("lost while reading")
            self._pump()
            if len(self._heard) >= size or self._woken or self._rig.time.now_s() >= until_s:
                self._woken = False
                found, self._heard = bytes(self._heard[:size]), self._heard[size:]
                return found
            self._rig.time.wait_until(min(until_s, self._rig.line.next_s() or math.inf), self)

    def discard_input(self) -> None:
        self._require_line("lost while reading")
        self._pump()
        self._heard.clear()

    def wake(self) -> None:
        self._woken = True
        self._rig.time.notify(self)

    def close(self) -> None:
        self.is_open = False

    def _pump(self) -> None:
        self._heard += self._rig.line.transmit(self._rig.time.now_s(), self._baud)

    def _require_line(self, doing: str) -> None:
        self._rig.truth_deg()  # lets what is scripted happen
        if not (self.is_open and self._rig.line.faults.plugged):
            raise LinkLost(f"serial port {self.path} {doing}: it is not there")


class SimulatedHeads:
    """Heads of one line at addresses 1, 2, …; ``keys`` are the driver's, the rest the emulator's settings."""

    def __init__(
        self,
        count: int = 1,
        baud: int = 9600,
        keys: Mapping[str, Any] | None = None,
        seed: int = 0,
        script: str = "",
        *,
        driver_baud: int | None = None,
        same_address: bool = False,
        **settings: Any,
    ) -> None:
        self.time = SimulatedTime()
        self.names = [f"pt{k + 1}" for k in range(count)]
        usual = {
            "baud": baud,
            "max_speed_deg_s": SPEED_DEG_S,
            "pan_limits_deg": (-175.0, 175.0),
            "tilt_limits_deg": (-95.0, 15.0),
        }
        self.line = PelcoDLine(
            [
                PelcoDHeadSettings.model_validate(
                    {
                        "id": name,
                        "address": 1 if same_address else k + 1,
                        **usual,
                        **settings,
                    }
                )
                for k, name in enumerate(self.names)
            ],
            clock=self.time,
            seed=seed,
            script=script,
        )
        sections = [
            PelcoDSection.model_validate(
                {"port": "/sim", "baud": driver_baud or baud, "address": k + 1, **(keys or {})}
            )
            for k in range(count)
        ]
        self.bus: Bus = buses_for(
            sections, self.time, lambda path, rate: SimulatedPort(self, path, rate), self.time.condition
        )["/sim"]
        self.heads = [
            PelcoDHead(spec(name), section, self.bus, self.time)
            for name, section in zip(self.names, sections, strict=True)
        ]

    @property
    def head(self) -> PelcoDHead:
        return self.heads[0]

    def move(self, pan_deg: float, tilt_deg: float) -> None:
        self.head.move_to(math.radians(pan_deg), math.radians(tilt_deg))

    def poll(self, duration_s: float) -> list[AxisReading]:
        """Read the first head for a while, as its worker does."""
        until_s = self.time.now_s() + duration_s
        readings: list[AxisReading] = []
        while self.time.now_s() < until_s:
            readings += self.head.read(0.3)
        return readings

    def serve(self, duration_s: float, pan_deg: float, tilt_deg: float) -> Service:
        """Serve the first head as its worker and the planner do: reopen with back-off, enable, send it to its aim."""
        until_s, retry_s, is_open, service = self.time.now_s() + duration_s, 0.2, False, Service()
        while self.time.now_s() < until_s:
            try:
                if not is_open:
                    self.head.open()
                    self.head.enable()
                    is_open, retry_s = True, 0.2
                    service.opened_s.append(self.time.now_s())
                if not service.aimed_s or self.time.now_s() - service.aimed_s[-1] > 1.0:
                    self.move(pan_deg, tilt_deg)
                    service.aimed_s.append(self.time.now_s())
                service.readings += self.head.read(0.3)
            except LinkLost as error:
                service.losses.append((self.time.now_s(), str(error)))
                self.head.close()
                is_open, service.aimed_s = False, []
                self.time.sleep_s(retry_s)
                retry_s = min(2.0 * retry_s, 5.0)
        return service

    def worst_error_deg(self, readings: Sequence[AxisReading]) -> float:
        """Return by how many degrees the worst of some readings is off, beyond three of its sigmas."""
        worst = 0.0
        for reading in readings:
            window_s = reading.stamp_sigma_s * math.sqrt(3.0)
            true_deg = [
                self.truth_deg(reading.stamp_s + part * window_s, reading.head_id)[reading.axis == "tilt"]
                for part in (-1.0, 0.0, 1.0)
            ]
            angle_deg = math.degrees(reading.angle_rad)
            off_deg = max(min(true_deg) - angle_deg, angle_deg - max(true_deg))
            worst = max(worst, off_deg - 3.0 * math.degrees(reading.sigma_rad))
        return worst

    def settle(self) -> None:
        """Close the head and let the line come to rest."""
        self.head.close()
        self.time.sleep_s(3.0)
        self.truth_deg()

    def truth_deg(self, stamp_s: float | None = None, name: str = "pt1") -> tuple[float, float]:
        pan_rad, tilt_rad = self.line.true_angles_rad(name, self.time.now_s() if stamp_s is None else stamp_s)
        return math.degrees(pan_rad), math.degrees(tilt_rad)

    def motions(self) -> Sequence[str]:
        """Return the frames heard that are no query: "stop" or their bytes."""
        frames = [frame for _, frame in self.line.received if frame[3] not in (0x45, 0x51, 0x53, 0x55)]
        return ["stop" if frame[2:6] == bytes(4) else frame.hex() for frame in frames]


def spec(name: str) -> HeadSpec:
    """Return a head as the rig knows it."""
    pan, tilt = (tuple(map(math.radians, limits)) for limits in (PAN_DEG, TILT_DEG))
    return HeadSpec(name, PanTilt(np.eye(4)), (pan[0], pan[1]), (tilt[0], tilt[1]), math.radians(SPEED_DEG_S))
