"""What can happen to an emulated drone, scripted or at once: the words of ``fault_script`` that drones know.

The link's: silent freeze latency S garble P lose P insert P drop N noise N unplug replug. The vehicle's:

    reboot                boots anew where it stands, in the air too
    no_pose               neither GPS nor poses come through
    ekf_failure           the same, and the firmware's patience with it is over at once
    jump M, jump_up M     the estimate is M metres off to the east, or upwards, all at once
    wind M/S              wind to the east
    battery P             the charge left, 0 to 1
    mode NAME             another ground station changes the mode
    clock S               the boot clock jumps by S seconds
    ignore_speed          changes of speed are acknowledged and forgotten
    clear                 ends all but what cannot be undone
"""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np

from camrig_emulators.fault_script import AMOUNTS, EVENTS, SWITCHES, FaultScript, Happening, Vocabulary, device_does
from camrig_emulators.faults import Faults
from camrig_emulators.mavlink.protocol import MavlinkProtocol
from camrig_emulators.mavlink.vehicle import Vehicle

_LONGEST_NOISE = 1000


def drone_faults(modes: dict[str, int]) -> Vocabulary:
    """Return the words for a firmware with these modes."""
    happens = dict.fromkeys(
        ("reboot", "ekf_failure", "jump", "jump_up", "battery", "mode", "clock", "noise"), device_does
    )
    return Vocabulary(
        switches={
            **{name: SWITCHES[name] for name in ("silent", "freeze")},
            "no_pose": device_does,
            "ignore_speed": device_does,
        },
        amounts={
            **{name: AMOUNTS[name] for name in ("latency", "garble", "lose", "insert")},
            "wind": device_does,
        },
        events={**EVENTS, **happens},
        counted=("drop", "jump", "jump_up", "battery", "clock", "noise"),
        probabilities=("garble", "lose", "insert", "battery"),
        signed=("jump", "jump_up", "clock", "wind"),
        words={"mode": {name: float(number) for name, number in modes.items()}},
    )


class Troubles:
    """Lets things happen to one vehicle and its links."""

    def __init__(self, vehicle: Vehicle, faults: Faults, links: list[MavlinkProtocol], seed: int) -> None:
        self._vehicle = vehicle
        self._faults = faults
        self._links = links
        self._rng = random.Random(seed)
        self._known = drone_faults(vehicle.firmware.modes)
        self._script = FaultScript(())
        self._does: dict[str, Callable[[float], None]] = {
            "reboot": self._reboot,
            "no_pose": self._blind,
            "ekf_failure": self._fail,
            "jump": self._jump,
            "jump_up": self._jump_up,
            "wind": self._blow,
            "battery": self._drain,
            "mode": self._change_mode,
            "clock": self._move_clock,
            "ignore_speed": self._ignore_speed,
            "noise": self._make_noise,
            "clear": self._clear,
        }
        vehicle.on_step = self._step

    def schedule(self, script: str, start_s: float) -> None:
        """Read what is to happen, from ``start_s`` on; raises InputError that names the statement."""
        self._script = FaultScript.parse(script, start_s, (), self._known)

    def now(self, statement: str, now_s: float) -> None:
        """Let one thing happen, such as ``wind 2``; raises InputError for what it does not know."""
        for happening in FaultScript.parse(f"at 0 {statement}", now_s, (), self._known).due(now_s):
            self._happen(happening)

    def _step(self, now_s: float) -> None:
        for happening in self._script.due(now_s):
            self._happen(happening)

    def _happen(self, happening: Happening) -> None:
        happening.set(self._faults)
        if happening.name in self._does:
            self._does[happening.name](happening.value)

    def _reboot(self, _: float) -> None:
        self._vehicle.reboot()

    def _blind(self, on: float) -> None:
        self._vehicle.cockpit.estimator.blinded = on > 0.0

    def _fail(self, _: float) -> None:
        self._vehicle.cockpit.estimator.fail()

    def _jump(self, east_m: float) -> None:
        self._vehicle.cockpit.estimator.jump(np.array([east_m, 0.0, 0.0]))

    def _jump_up(self, up_m: float) -> None:
        self._vehicle.cockpit.estimator.jump(np.array([0.0, 0.0, up_m]))

    def _blow(self, speed_m_s: float) -> None:
        self._vehicle.wind_m_s = speed_m_s

    def _drain(self, charge: float) -> None:
        self._vehicle.battery.set(charge, self._vehicle.cockpit.now_s)

    def _change_mode(self, mode: float) -> None:
        self._vehicle.firmware.change_mode(int(mode))

    def _move_clock(self, by_s: float) -> None:
        self._vehicle.boot_s -= by_s

    def _ignore_speed(self, on: float) -> None:
        self._vehicle.cockpit.ignores_speed = on > 0.0

    def _make_noise(self, count: float) -> None:
        for link in self._links:
            link.make_noise(self._rng.randbytes(min(_LONGEST_NOISE, round(count))))

    def _clear(self, _: float) -> None:
        self._blind(0.0)
        self._blow(0.0)
        self._ignore_speed(0.0)
