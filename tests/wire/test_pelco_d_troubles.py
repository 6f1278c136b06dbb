"""The ten troubles that matter most, in real time over a pty: what is true in simulated time holds on a real port."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from camrig.errors import LinkLost
from camrig.geometry.pan_tilt import PanTilt
from camrig.messages import AxisReading
from camrig.rig import HeadSpec
from camrig_drivers.pelco_d import driver
from camrig_emulators.pelco_d_head import PelcoDHeadSettings, PelcoDLine

pytestmark = pytest.mark.realtime

BAUD = 38400
AIM_DEG = (60.0, -40.0)
STOP = bytes.fromhex("ff010000000001")


@dataclass
class Served:
    """What became of a head that a worker served: readings, and why its link was lost."""

    line: PelcoDLine
    readings: list[AxisReading] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    lost_s: float = -math.inf

    def wait(self, what: str, seconds: float = 6.0) -> None:
        """Wait until it looks at its aim and says so, or until its link is lost."""
        until_s = time.monotonic() + seconds
        while not (self.reasons if what == "lost" else self.is_there()):
            assert time.monotonic() < until_s, f"not {what}: {self.line.describe()}; {self.reasons}"
            time.sleep(0.01)

    def is_there(self) -> bool:
        now_s = time.monotonic()
        angles = self.line.true_angles_rad("pt1", now_s)
        fresh = [reading for reading in self.readings[-4:] if reading.stamp_s > max(now_s - 1.0, self.lost_s)]
        return bool(fresh) and all(abs(math.degrees(a) - b) < 0.11 for a, b in zip(angles, AIM_DEG, strict=True))


@contextmanager
def serving(keys: dict[str, Any] | None = None, script: str = "", **settings: Any) -> Iterator[Served]:
    """Serve a head in a thread as its worker does: open with back-off, enable, send to its aim, read."""
    usual = {"id": "pt1", "baud": BAUD, "max_speed_deg_s": 120.0, "acceleration_deg_s2": 400.0, "reset_s": 2.0}
    line = PelcoDLine([PelcoDHeadSettings.model_validate({**usual, **settings})], seed=1, script=script)
    section = driver.section.model_validate({"port": line.start(), "baud": BAUD, "gap_s": 0.01, **(keys or {})})
    limits = (math.radians(-170.0), math.radians(170.0)), (math.radians(-90.0), math.radians(10.0))
    head = driver.make({"pt1": (HeadSpec("pt1", PanTilt(np.eye(4)), *limits, math.radians(120.0)), section)})["pt1"]
    served, ending = Served(line), threading.Event()

    def work() -> None:
        aimed_s = -math.inf
        while not ending.is_set():
            try:
                head.open()
                if aimed_s == -math.inf:
                    head.enable()
                if time.monotonic() > aimed_s + 1.0:
                    aimed_s = time.monotonic()
                    head.move_to(math.radians(AIM_DEG[0]), math.radians(AIM_DEG[1]))
                served.readings += head.read(0.3)
            except LinkLost as error:
                head.close()
                served.reasons.append(str(error))
                served.lost_s = time.monotonic()
                aimed_s = -math.inf
                ending.wait(0.1)

    worker = threading.Thread(target=work, name="pt1")
    worker.start()
    try:
        yield served
    finally:
        ending.set()
        worker.join()
        head.close()
        time.sleep(0.05)
        motions = [frame for _, frame in line.received if frame[3] not in (0x51, 0x53)]
        line.stop()
    assert motions == [] or motions[-1] == STOP
    check(served)


def check(served: Served) -> None:
    """Fail on a reading that was not the truth at any time within its window."""
    for reading in served.readings:
        # A reply under way when the power is cut was sampled as if the motion went on: 10 ms.
        window_s = 2.0 * reading.stamp_sigma_s + 0.012
        angles = [
            served.line.true_angles_rad("pt1", reading.stamp_s + part * window_s)[reading.axis == "tilt"]
            for part in (-1.0, 0.0, 1.0)
        ]
        slack_rad = 3.0 * reading.sigma_rad
        assert min(angles) - slack_rad <= reading.angle_rad <= max(angles) + slack_rad


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("at 1.2 unplug; at 1.9 replug", "serial port"),
        ("from 1.2 to 2.5 silent", "queries in a row unanswered"),
        ("from 1.2 to 2.5 swapped", "queries in a row unanswered"),
        ("from 1.2 to 2.5 lost_last 3", "no answer"),
        ("at 1.2 on pt1 reset", "queries in a row unanswered"),
    ],
    ids=["unplugged", "silence", "garbage", "half frames", "brown-out"],
)
def test_a_lost_link_comes_back_by_itself(script: str, reason: str) -> None:
    with serving(script=script) as served:
        served.wait("lost")
        served.wait("there")
    assert reason in served.reasons[0]


@pytest.mark.parametrize(
    ("script", "settings", "keys"),
    [
        ("at 0 echo; at 0 splits", {}, {}),
        ("at 0 lost_first 2", {}, {"resync_tail": True}),
        ("", {"absolute": "race"}, {}),
        ("", {"reports": "target"}, {}),
        ("from 0.2 to 3 garble 0.01; from 0.2 to 3 bursts 0.3", {}, {}),
    ],
    ids=["echo byte by byte", "cut at the turn-around", "race", "reports its target", "noise"],
)
def test_a_strange_head_gets_there_and_is_never_believed_wrongly(
    script: str, settings: dict[str, Any], keys: dict[str, Any]
) -> None:
    with serving(keys, script, **settings) as served:
        served.wait("there", 12.0)
    assert served.reasons == []
