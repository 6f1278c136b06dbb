"""A rig in memory in simulated time: fakes on a manual clock, exact pictures, late measurements, a planner in process.

Everything that happens is an event with a time of its own: a frame is taken, its detections arrive later, an axis is
read, a plan comes back. ``pipeline.step`` runs at its fixed rate among them. What truly is (kinematics, lens, routes)
comes from camrig_emulators and OpenCV, not from camrig.geometry. Nothing here depends on the real clock.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Literal

import numpy as np

from camrig import optimise
from camrig.clock import ManualClock
from camrig.config.settings import MAX_INCIDENCE_RAD, REACH_PERIODS
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp
from camrig.messages import (
    AxisReading,
    DroneReading,
    HeadAim,
    HeadCommand,
    LinkReport,
    LinkStatus,
    PlannerAnswer,
    PlannerRequest,
    PlanRequest,
    TagDetection,
    TagDetections,
)
from camrig.optimise import PlannerSettings
from camrig.pipeline import Inputs, Outputs, Settings, State, begin, step
from camrig.rig import HeadMount, Rig, TagKey
from camrig_emulators import carriers, robots
from camrig_emulators.fakes import FakeDrone, FakeHead
from tests.simulated_room import AWAY, LENS, MIN_SIDE_PX, room, tag_in_picture
from tests.simulated_score import Tick

START_S = 100.0
TICK_S = 0.02
FRAME_S = 0.125
FRAME_LATE_S = 0.08
FRAME_JITTER_S = 0.04
"""Frames arrive this much around ``FRAME_LATE_S``, so those of several cameras overtake each other."""
AXIS_S = 0.075
AXIS_LATE_S = 0.02
DRONE_S = 0.05
ANSWER_S = 0.1
EXPOSURE_S = 0.005
MOST_BLUR_PX = 3.0
CORNER_SIGMA_PX = 0.1
PLANNER_ASK_S = 0.01
"""How much later the planner's clock is each time it is asked: some plans end at their deadline."""
SETTINGS = Settings(
    PlannerSettings(
        visibility="image",
        margin_rad=math.radians(2.0),
        min_tag_px=MIN_SIDE_PX,
        max_incidence_rad=MAX_INCIDENCE_RAD,
        gain=0.02,
        reach_s=REACH_PERIODS,
    )
)


@dataclass
class Simulation:
    """The room, running. ``run`` goes on; between two runs a test may hold, unplug, hide or move things."""

    seed: int
    rig: Rig = field(default_factory=room)
    settings: Settings = SETTINGS
    start: HeadAim = AWAY
    ticks: list[Tick] = field(default_factory=list)
    hidden: set[str] = field(default_factory=set)
    shifts: dict[str, Array] = field(default_factory=dict)
    """How far, (3,) m, a target is from its route."""

    def __post_init__(self) -> None:
        self.clock = ManualClock(START_S)
        self.heads = {name: FakeHead(spec, clock=self.clock, start=self.start) for name, spec in self.rig.heads.items()}
        self.drones = {name: FakeDrone(spec, clock=self.clock) for name, spec in self.rig.drones.items()}
        self.state: State = begin(START_S)
        self._motions = robots.plan_motions(self.rig.targets, self.rig.space, robots.RobotLimits(), self.seed)
        self._rng = np.random.default_rng(self.seed)
        self._zero_rad = {name: self._rng.normal(0.0, head.bias_sigma_rad, 2) for name, head in self.rig.heads.items()}
        self._drone_error = {
            name: _small_pose(self._rng, drone.position_sigma_m, drone.attitude_sigma_rad)
            for name, drone in self.rig.drones.items()
        }
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()
        self._box = _Box()
        self._down: set[str] = set()
        self._start()

    # --- what a test does ------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        return self.clock.now_s()

    def run(self, duration_s: float, until: Callable[[Tick], bool] | None = None) -> bool:
        """Go on for a time, or until a tick of which ``until`` says so; tell whether it did."""
        end_s = self.now_s + duration_s
        while self._events[0][0] <= end_s:
            at_s, _, happen = heapq.heappop(self._events)
            self.clock.advance(max(0.0, at_s - self.now_s))
            before = len(self.ticks)
            happen()
            if until is not None and len(self.ticks) > before and until(self.ticks[-1]):
                return True
        return False

    def unplug(self, camera: str) -> None:
        """Lose a camera's link; frames already on their way still arrive."""
        self._down.add(camera)
        self._box.links.append(LinkReport(camera, LinkStatus.LOST, self.now_s, "unplugged"))

    def truth(self) -> dict[str, Transform]:
        """Return the true ``T_world_body`` of every target now, hidden or not."""
        poses = robots.poses(self._motions, self.now_s - START_S)
        for name, shift in self.shifts.items():
            poses[name][:3, 3] += shift
        return poses

    def true_camera_pose(self, camera: str) -> Transform:
        """Return the true ``T_world_camera`` now, zero errors of its head included."""
        return carriers.camera_pose(self.rig, camera, self.now_s, self._angles, lambda name, _: self._body(name))

    def visible(self, camera: str) -> dict[TagKey, Array]:
        """Return the exact (4, 2) corners of every tag that the camera's picture shows well enough to be found."""
        T_world_camera = self.true_camera_pose(camera)
        return {
            key: corners
            for key, T_world_tag, size_m in self._tags()
            if (corners := tag_in_picture(LENS, T_world_camera, T_world_tag, size_m)) is not None
        }

    # --- what happens by itself ------------------------------------------------------------------------

    def _start(self) -> None:
        devices = (*self.rig.cameras, *self.rig.heads, *self.rig.drones)
        self._box.links += [LinkReport(name, LinkStatus.UP, START_S) for name in devices]
        for head in self.heads.values():
            head.enable()
        for drone in self.drones.values():
            drone.arm()
        for k, camera in enumerate(self.rig.cameras):
            self._at(START_S + 0.011 + 0.029 * k, partial(self._take_frame, camera, 0))
        for k, name in enumerate(self.heads):
            self._at(START_S + 0.007 * k, partial(self._read_axis, name, "pan"))
        for name in self.drones:
            self._at(START_S, partial(self._read_drone, name))
        self._at(START_S, self._tick)

    def _at(self, at_s: float, happen: Callable[[], None]) -> None:
        heapq.heappush(self._events, (at_s, next(self._numbers), happen))

    def _take_frame(self, camera: str, number: int) -> None:
        self._at(self.now_s + FRAME_S, partial(self._take_frame, camera, number + 1))
        if camera in self._down:
            return
        shown = {} if self._blur_px(camera) > MOST_BLUR_PX else self.visible(camera)
        tags = tuple(
            TagDetection(key, corners + self._rng.normal(0.0, CORNER_SIGMA_PX, (4, 2)), _pair(corners), 0, 60.0)
            for key, corners in shown.items()
        )
        found = TagDetections(camera, self.now_s, number, LENS.size_px, tags, FRAME_LATE_S)
        late_s = FRAME_LATE_S + self._rng.uniform(-FRAME_JITTER_S, FRAME_JITTER_S)
        self._at(self.now_s + late_s, lambda: self._box.detections.append(found))

    def _read_axis(self, head: str, axis: Literal["pan", "tilt"]) -> None:
        self._at(self.now_s + AXIS_S, partial(self._read_axis, head, "tilt" if axis == "pan" else "pan"))
        reading = next(reading for reading in self.heads[head].read(0.0) if reading.axis == axis)
        self._at(self.now_s + AXIS_LATE_S, lambda: self._box.axis_readings.append(reading))

    def _read_drone(self, drone: str) -> None:
        self._at(self.now_s + DRONE_S, partial(self._read_drone, drone))
        for reading in self.drones[drone].read(0.0):
            told = replace(reading, T_world_body=reading.T_world_body @ self._drone_error[drone])
            self._box.drone_readings.append(told)

    def _tick(self) -> None:
        number = len(self.ticks) + 1
        self._at(START_S + number * TICK_S, self._tick)
        enabled = frozenset(name for name, head in self.heads.items() if head.enabled) | self.drones.keys()
        inputs, self._box = self._box.inputs(enabled), _Box()
        scanning = self.state.mission.scanning
        self.state, outputs = step(self.state, inputs, self.rig, self.settings, self.now_s)
        self.ticks.append(Tick(self.now_s, inputs, outputs, scanning, self.truth()))
        self._obey(outputs)

    def _obey(self, outputs: Outputs) -> None:
        """Hand out commands, which the fakes refuse outside limits and boxes, and answer the planner's request."""
        for command in outputs.commands:
            if isinstance(command, HeadCommand):
                self.heads[command.head_id].move_to(command.aim.pan_rad, command.aim.tilt_rad)
            else:
                self.drones[command.drone_id].go_to(command.aim.position_m, command.aim.yaw_rad)
        if outputs.request is not None:
            answer = answered(self.rig, outputs.request, self.settings.planner)
            self._at(self.now_s + ANSWER_S, lambda: self._box.put_answer(answer))

    # --- what truly is -----------------------------------------------------------------------------------

    def _angles(self, head: str, stamp_s: float) -> tuple[float, float]:
        pan_rad, tilt_rad = self.heads[head].true_angles_rad(stamp_s)
        return pan_rad + float(self._zero_rad[head][0]), tilt_rad + float(self._zero_rad[head][1])

    def _body(self, drone: str) -> Transform:
        return self.drones[drone].T_world_body()

    def _blur_px(self, camera: str) -> float:
        match self.rig.cameras[camera].mount:
            case HeadMount(head=name):
                now, before = (np.array(self._angles(name, self.now_s - ago_s)) for ago_s in (0.0, EXPOSURE_S))
                return LENS.focal_px[0] * float(np.abs(now - before).max())
        return 0.0

    def _tags(self) -> list[tuple[TagKey, Transform, float]]:
        truth = self.truth()
        anchors = [(anchor.key, anchor.T_world_tag, anchor.size_m) for anchor in self.rig.anchors]
        shown = [body for name, body in self.rig.targets.items() if name not in self.hidden]
        return anchors + [(tag.key, truth[body.id] @ tag.T_body_tag, tag.size_m) for body in shown for tag in body.tags]


@dataclass
class _Box:
    """What has arrived since the last tick."""

    detections: list[TagDetections] = field(default_factory=list)
    axis_readings: list[AxisReading] = field(default_factory=list)
    drone_readings: list[DroneReading] = field(default_factory=list)
    links: list[LinkReport] = field(default_factory=list)
    answer: PlannerAnswer | None = None

    def put_answer(self, answer: PlannerAnswer) -> None:
        self.answer = answer

    def inputs(self, enabled: frozenset[str]) -> Inputs:
        """Return all of it as a tick's inputs."""
        return Inputs(
            detections=tuple(self.detections),
            axis_readings=tuple(self.axis_readings),
            drone_readings=tuple(self.drone_readings),
            links=tuple(self.links),
            answer=self.answer,
            enabled=enabled,
        )


def answered(rig: Rig, request: PlannerRequest, settings: PlannerSettings) -> PlannerAnswer:
    """Answer as the planner's process does; its clock counts how often it is asked: no answer depends on the load."""
    asked = count()
    if isinstance(request, PlanRequest):
        return optimise.plan_for(rig, request, settings, lambda: PLANNER_ASK_S * next(asked))
    return optimise.scan_for(rig, request, settings, lambda: PLANNER_ASK_S * next(asked))


def _small_pose(rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> Transform:
    return transform(rotation_exp(rng.normal(0.0, sigma_rad, 3)), rng.normal(0.0, sigma_m, 3))


def _pair(corners: Array) -> tuple[float, float]:
    x, y = corners.mean(axis=0).tolist()
    return x, y
