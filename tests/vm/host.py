"""A guest with systemd as the host of a rig: its commands, its service, and what that publishes beside the truth."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camrig.interfaces import World
from tests.vm.bench import Wire
from tests.vm.machine import Machine

CLOCK_QUESTIONS = 6


@dataclass
class Host:
    """The rig's host."""

    machine: Machine
    wire: Wire
    world: World

    def measured(self, what: str, value: float) -> None:
        """Tell a figure, in seconds or metres, to whoever reads the run's output."""
        print(f"\n{what}: {value:.3f}", flush=True)

    def sh(self, command: str, timeout_s: float = 200.0) -> str:
        status, said = self.machine.shell(command, timeout_s)
        assert status == 0, f"{command}: exit code {status}: {said}"
        return said

    def show(self, name: str) -> str:
        return self.sh(f"systemctl show camrig -P {name}").strip()

    def write(self, path: str, text: str) -> None:
        (self.machine.share / "file").write_text(text)
        self.sh(f"mkdir -p {Path(path).parent} && cat /run/vm/file >{path}")

    def until(self, condition: Callable[[], bool], timeout_s: float, every_s: float = 0.5) -> float:
        """Wait; return how long it took."""
        began_s = time.monotonic()
        while not condition():
            assert time.monotonic() - began_s < timeout_s, self.sh(
                "systemctl status camrig; journalctl -u camrig -n 40"
            )
            time.sleep(every_s)
        return time.monotonic() - began_s

    def tracks(self) -> bool:
        return self.show("StatusText").startswith("tracking: 1 of 1 targets")

    def is_active(self, other_than: str) -> bool:
        """Tell whether it is up, as another process than that."""
        return self.show("MainPID") not in (other_than, "0") and self.show("ActiveState") == "active"

    def clock(self) -> tuple[float, float]:
        """Return how far the guest's clock is ahead of ours and by how much that may be wrong."""
        answers = []
        for _ in range(CLOCK_QUESTIONS):
            asked_s = time.monotonic()
            guest_s = float(self.sh("cut -d' ' -f1 /proc/uptime"))
            heard_s = time.monotonic()
            answers.append((0.5 * (heard_s - asked_s), guest_s - 0.5 * (asked_s + heard_s)))
        unsure_s, ahead_s = min(answers)
        return ahead_s, unsure_s

    def errors_m(self, since_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each place published as tracked was from where the robot was then, and one sigma of it.

        Then: from when it was last seen to the stamp, by a clock that is known to some hundredths of a second.
        """
        ahead_s, unsure_s = self.clock()
        lines = self.sh("tail -n 400 /var/lib/camrig/targets.jsonl").splitlines()
        whole = [json.loads(line) for line in lines if line.endswith("}") and '"tracked"' in line]
        found = []
        for line in whole:
            stamp_s = line["stamp_s"] - ahead_s
            if stamp_s > since_s:
                times_s = np.arange(stamp_s - line["age_s"] - unsure_s, stamp_s + unsure_s + 0.02, 0.02)
                path_m = np.array([self.world.truth(time_s)["robot1"][:3, 3] for time_s in times_s])
                off_m = np.linalg.norm(path_m - line["position_m"], axis=1).min()
                found.append((off_m, math.sqrt(np.trace(line["covariance_m2"]))))
        errors_m, sigmas_m = np.array(found).reshape(-1, 2).T
        return errors_m, sigmas_m
