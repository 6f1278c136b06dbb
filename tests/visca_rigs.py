"""The VISCA driver with an emulated head at its end, for the contract of heads: see contract/test_head_contract."""

from __future__ import annotations

import time

from camrig.interfaces import Head
from camrig.rig import HeadSpec
from camrig_drivers.visca import driver
from camrig_emulators.visca_head import ViscaHeadSettings, ViscaLine, ViscaUdpHead

AXES = {"pan": {"deg_per_count": 0.075, "sign": -1}, "tilt": {"deg_per_count": 0.075, "sign": 1}}


def quick_head(**changed: object) -> ViscaHeadSettings:
    """Return a head fast enough for a test that waits for it."""
    quick = {"id": "pt1", "max_speed_deg_s": 120.0, "acceleration_deg_s2": 300.0}
    return ViscaHeadSettings.model_validate(quick | changed)


class _ViscaRig:
    """What rigs on every port share."""

    guarded = True

    def __init__(self, spec: HeadSpec, emulator: ViscaLine | ViscaUdpHead, **section: object) -> None:
        self._emulator = emulator
        made = driver.make(
            {
                "pt1": (
                    spec,
                    driver.section(port=emulator.start(), axes=AXES, gap_s=0.005, reply_timeout_s=0.4, **section),
                )
            }
        )
        self.head: Head = made["pt1"]
        self.faults = emulator.faults

    def orders(self) -> list[str]:
        return [order for _, message in self._emulator.received if (order := _order(message))]

    def true_angles_rad(self) -> tuple[float, float]:
        return self._emulator.true_angles_rad("pt1", time.monotonic())

    def take_down(self) -> None:
        self.head.close()
        self._emulator.stop()


class ViscaSerialRig(_ViscaRig):
    """Over a pty."""

    def __init__(self, spec: HeadSpec) -> None:
        line = ViscaLine([quick_head(address=3, baud=38400)])
        super().__init__(spec, line, baud=38400, address=3)


class ViscaUdpRig(_ViscaRig):
    """Over UDP with Sony's header."""

    def __init__(self, spec: HeadSpec) -> None:
        super().__init__(spec, ViscaUdpHead(quick_head()))


class ViscaRawUdpRig(_ViscaRig):
    """Over UDP without a header."""

    def __init__(self, spec: HeadSpec) -> None:
        super().__init__(spec, ViscaUdpHead(quick_head(), sony=False), header=False)


def _order(message: bytes) -> str:
    """Name a message; anything that is neither an inquiry, a cancel nor a stop counts as a motion."""
    body = message[1:-1]
    if body[:3] == b"\x01\x06\x01" and body[-2:] == b"\x03\x03":
        return "stop"
    return "" if body[:1] == b"\x09" or body[0] & 0xF0 == 0x20 else "move"
