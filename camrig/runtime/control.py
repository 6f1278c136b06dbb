"""The control thread: it alone owns the pipeline's state, ticks at a fixed rate and calls ``pipeline.step``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from camrig.clock import Clock
from camrig.interfaces import Published, Sink
from camrig.messages import DroneCommand, Event, HeadCommand, Level, LinkReport, LinkStatus
from camrig.pipeline import Inputs, Outputs, Settings, State, begin, rescan, step
from camrig.rig import Rig
from camrig.runtime.camera_job import CameraJob
from camrig.runtime.drone_job import DroneJob
from camrig.runtime.head_job import HeadJob
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.planner_link import PlannerLink

log = logging.getLogger(__name__)

TICK_S = 0.02
LEAST_TICK_S = 0.002
"""A tick follows the one before after ``TICK_S``; as soon as a camera has found something, but not sooner than this."""

ItemT = TypeVar("ItemT")


@dataclass(frozen=True)
class Devices:
    """The jobs of all devices, by id."""

    cameras: Mapping[str, CameraJob]
    heads: Mapping[str, HeadJob]
    drones: Mapping[str, DroneJob]


@dataclass
class Control:
    """Gathers what the workers measured, steps the pipeline, and hands out commands and results."""

    rig: Rig
    settings: Settings
    devices: Devices
    planner: PlannerLink
    sinks: Sequence[Sink]
    links: Mailbox[LinkReport]
    clock: Clock
    state: State = field(init=False)
    beat_s: float = field(init=False)
    latest: Published | None = None
    link_states: dict[str, LinkStatus] = field(default_factory=dict)
    orders: Mailbox[Callable[[State], State]] = field(default_factory=lambda: Mailbox(8))

    def __post_init__(self) -> None:
        self.beat_s = self.clock.now_s()
        self.state = begin(self.beat_s)

    def tick(self) -> None:
        """Do one turn of the loop; never blocks."""
        self.beat_s = now_s = self.clock.now_s()
        for order in self.orders.take_all():
            self.state = order(self.state)
        inputs = self._gather()
        self.state, outputs = step(self.state, inputs, self.rig, self.settings, now_s)
        if outputs.request is not None:
            self.planner.submit(outputs.request)
        self._command(outputs)
        self._expect(outputs)
        self._publish(outputs.published)

    def rescan(self) -> None:
        """Operator's order: scan the whole floor again; any thread."""
        self.orders.put(lambda state: rescan(state, self.clock.now_s()))

    def _gather(self) -> Inputs:
        devices = self.devices
        actuators: list[HeadJob | DroneJob] = [*devices.heads.values(), *devices.drones.values()]
        links = self.links.take_all()
        for report in links:
            self.link_states[report.device_id] = report.status
        told = [*(job.refusals for job in devices.drones.values()), *(job.notes for job in devices.cameras.values())]
        return Inputs(
            detections=_all(job.detections.take_all() for job in devices.cameras.values()),
            axis_readings=_all(job.readings.take_all() for job in devices.heads.values()),
            drone_readings=_all(job.readings.take_all() for job in devices.drones.values()),
            links=links,
            answer=self.planner.poll(),
            enabled=frozenset(job.name for job in actuators if job.follows_plans),
            begin=frozenset(job.name for job in devices.drones.values() if job.begins),
            events=_all(mailbox.take_all() for mailbox in told),
        )

    def _command(self, outputs: Outputs) -> None:
        for command in outputs.commands:
            match command:
                case HeadCommand(head_id=name, aim=aim):
                    self.devices.heads[name].commands.put(aim)
                case DroneCommand(drone_id=name, aim=drone_aim):
                    self.devices.drones[name].commands.put(drone_aim)
        for reading in outputs.head_angles:
            self.devices.heads[reading.head_id].seen.put(reading)

    def _expect(self, outputs: Outputs) -> None:
        if outputs.expected is None:
            return
        found = {expected.camera_id: expected for expected in outputs.expected}
        for name, job in self.devices.cameras.items():
            if name in found:
                job.expected.put(found[name])
            else:
                job.expected.clear()

    def _publish(self, published: Published) -> None:
        for event in published.events:
            log.log(_LOG_LEVELS[event.level], "%s: %s", event.about, event.text, extra=self._about(event, published))
        for sink in self.sinks:
            sink.write(published)
        self.latest = published

    def _about(self, event: Event, published: Published) -> dict[str, str]:
        """Return what the log is told beside an event's text: which device or target, and how it is."""
        if event.about in self.link_states:
            return {"device": event.about, "state": self.link_states[event.about].value}
        statuses = {target.id: target.status.value for target in published.targets}
        return {"target": event.about, "state": statuses[event.about]} if event.about in statuses else {}


_LOG_LEVELS = {Level.INFO: logging.INFO, Level.WARNING: logging.WARNING}


def _all(groups: Iterable[tuple[ItemT, ...]]) -> tuple[ItemT, ...]:
    return tuple(item for group in groups for item in group)
