"""A daemon as the operator's handler and socket see it, without its threads and devices."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from camrig.errors import InputError
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import PanTilt
from camrig.interfaces import Published
from camrig.messages import (
    AxisReading,
    DroneHealth,
    Event,
    FlightState,
    HeadAim,
    Level,
    LinkReport,
    LinkStatus,
    Target,
    TargetStatus,
)
from camrig.pipeline import State, begin
from camrig.rig import CameraSpec, DroneMount, DroneSpec, FixedMount, HeadSpec, Rig, Space
from camrig.runtime.operator import Operator
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_socket import claimed
from camrig.runtime.operator_status import RecentEvents, View

LENS = BrownLens((640, 480), (420.0, 420.0), (320.0, 240.0), (0.0, 0.0, 0.0, 0.0, 0.0))
DEVICES = ("north", "sky", "pt1", "pt2", "d1")


def rig(name: str = "lab") -> Rig:
    """Return two heads, a drone and two cameras."""
    head = HeadSpec("pt1", PanTilt(np.eye(4)), (-3.0, 3.0), (-1.5, 0.0), 0.5)
    return Rig(
        name,
        Space(),
        {
            "north": CameraSpec("north", LENS, FixedMount(np.eye(4))),
            "sky": CameraSpec("sky", LENS, DroneMount("d1", np.eye(4))),
        },
        {"pt1": head, "pt2": replace(head, id="pt2")},
        {"d1": DroneSpec("d1", ((0.5, 0.5, 1.0), (4.5, 2.5, 2.5)), 0.8, 0.5)},
    )


def target(name: str, status: TargetStatus, last_seen_s: float, variance_m2: float = 0.0004) -> Target:
    """Return a target at (1, 2, 0) m, or an unseen one as fusion says it."""
    known = status is not TargetStatus.UNSEEN
    position = np.array([1.0, 2.0, 0.0]) if known else np.full(3, np.nan)
    covariance = np.diag(np.full(3, variance_m2 if known else np.inf))
    return Target(name, 0.0, status, position, np.zeros(3), covariance, np.eye(3), ("north",), last_seen_s)


@dataclass
class Desk:
    """Keeps what it was ordered; a test sets what is known, and ``now_s``."""

    rig: Rig = field(default_factory=rig)
    state: State = field(default_factory=lambda: begin(0.0))
    targets: tuple[Target, ...] = ()
    delivered: Mapping[str, int] = field(default_factory=dict)
    enabled: frozenset[str] = frozenset({"pt1"})
    aimed: dict[str, HeadAim] = field(default_factory=dict)
    statistics: dict[str, dict[str, float]] = field(default_factory=dict)
    health: dict[str, DroneHealth] = field(default_factory=dict)
    now_s: float = 0.0
    done: list[tuple[str, tuple[str, ...]]] = field(default_factory=list)
    failing: Mapping[str, str] = field(default_factory=dict)
    lent: frozenset[str] = frozenset()
    arming: FlightState | Event = FlightState.TAKING_OFF
    events: RecentEvents = field(default_factory=RecentEvents)

    def __post_init__(self) -> None:
        for device in DEVICES:
            self.link(device, LinkStatus.UP)

    def operator(self) -> Operator:
        return Operator(self, self.events)

    def link(self, device: str, status: LinkStatus, reason: str = "") -> None:
        report = LinkReport(device, status, 0.0, reason)
        self.state = replace(self.state, links={**self.state.links, device: report})

    def points(self, head: str, pan_rad: float, tilt_rad: float) -> None:
        """Have a head report where it points now."""
        histories = self.state.histories
        for axis, angle_rad in (("pan", pan_rad), ("tilt", tilt_rad)):
            histories = histories.with_reading(AxisReading(head, axis, angle_rad, self.now_s, 0.001, 0.0))  # type: ignore[arg-type]
        self.state = replace(self.state, histories=histories)

    def view(self) -> View:
        delivered, aimed = dict(self.delivered), dict(self.aimed)
        return View(
            self.rig,
            self.state,
            self.targets,
            delivered,
            self.enabled,
            self.now_s,
            aimed,
            dict(self.statistics),
            dict(self.health),
            frozenset(name for name, health in self.health.items() if health.obeys),
            self.lent,
        )

    def hold(self) -> Mapping[str, str]:
        self.done.append(("hold", ()))
        self.lent = frozenset()
        return self.failing

    def resume(self, devices: Collection[str]) -> None:
        self.done.append(("resume", tuple(devices)))
        for name in devices:
            if name in self.rig.drones:
                self.health[name] = DroneHealth("flying", obeys=True)

    def aim(self, head: str, aim: HeadAim) -> None:
        self.done.append(("aim", (head,)))
        self.aimed[head] = aim

    def lend(self, head: str, for_s: float, *, renew: bool = False) -> Collection[str]:
        if renew and head not in self.lent:
            raise InputError(f"head {head} is not lent any more")
        self.done.append(("renew" if renew else "lend", (head, str(for_s))))
        self.lent = frozenset({head, "north"}) if for_s else frozenset()
        status = LinkStatus.CLOSED if for_s else LinkStatus.UP
        links = {name: LinkReport(name, status, self.now_s) for name in (head, "north")}
        self.state = replace(self.state, links={**self.state.links, **links})
        return ("north", head)

    def arm(self, drone: str) -> None:
        self.done.append(("arm", (drone,)))
        match self.arming:
            case FlightState():
                self.state = replace(self.state, flight={drone: self.arming})
            case Event():
                self.events.write(Published(self.now_s, (), (self.arming,)))

    def land(self, drone: str) -> None:
        self.done.append(("land", (drone,)))
        self.state = replace(self.state, flight={drone: FlightState.LANDING})

    def rescan(self) -> None:
        self.done.append(("scan", ()))


def refusal(stamp_s: float, text: str = "drone d1 is not armed: battery at 12 %") -> Event:
    """Return what a drone says that will not fly."""
    return Event(stamp_s, Level.WARNING, "d1", text)


@contextmanager
def serving_at(folder: Path, operator: Operator, name: str = "lab") -> Iterator[Path]:
    """Serve an operator as ``camrig run`` does."""
    failures: list[str] = []
    with claimed(name, folder) as listener, serving(listener, operator, lambda: failures.append("failed")):
        yield folder / f"{name}.sock"
    assert not failures
