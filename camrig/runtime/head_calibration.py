"""A head calibrated with its own devices: opened, enabled, moved, and stopped however it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from camrig.calibrate.head import calibrate_head, with_known_flanks
from camrig.calibrate.head_result import AXES, HeadResult
from camrig.calibrate.head_timing import axis_timing, report_age
from camrig.clock import Clock
from camrig.config.rig_file import DeviceConfig, DeviceGroup, RigConfig
from camrig.errors import HardwareError, InputError, PartialError
from camrig.interfaces import Head, TurnsByStep
from camrig.messages import AxisFindings, HeadFindings, HeadGrade, LinkReport, LinkStatus, TagDetections
from camrig.rig import HeadSpec, Interval
from camrig.runtime.build import make_detector, make_devices
from camrig.runtime.camera_job import CameraJob
from camrig.runtime.enabled_head import enabled
from camrig.runtime.head_bench import DoesNotGo, Eye, HeadBench
from camrig.runtime.head_survey import Place, Survey, Tell, survey
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.steady_focus import check_focus
from camrig.runtime.worker import Worker

_KEPT = 256
_JOIN_S = 3.0
_FULL_TURN_RAD = 6.28
_ROUGH_SHARES, _ROUGH_S = (0.0, 0.05, 0.2, 0.6), 0.7
_ROUGH_ROOM_RAD, _BEYOND_ROOM_RAD = math.radians(20.0), math.radians(8.0)
_LEAST_RATE_RAD_S = math.radians(0.3)
_FASTER = 3.0
"""A file's speed may be so far below the truth, in the angles that its counting makes of it."""


@dataclass
class CameraEye:
    """``Eye``: one camera's worker and what it found; ``check`` looks at the open camera before its first picture
    counts.
    """

    worker: Worker
    found: Mailbox[TagDetections]
    links: Mailbox[LinkReport]
    check: Callable[[], None]
    checked: bool = False

    def take(self) -> Sequence[TagDetections]:
        for report in self.links.take_all():
            if report.status is LinkStatus.LOST:
                raise HardwareError(f"camera {report.device_id} is lost: {report.reason}")
        if self.worker.failed is not None:
            raise HardwareError(f"camera {self.worker.job.name} failed: {self.worker.failed}")
        found = self.found.take_all()
        if found and not self.checked:
            self.check()
            self.checked = True
        return found


@contextmanager
def camera_eye(config: RigConfig, camera_id: str, clock: Clock) -> Iterator[Eye]:
    """Run one camera's worker while inside; it opens and closes the camera. Looking through one that focuses by itself
    raises InputError.
    """
    one = replace(config, devices={**config.devices, "cameras": _only(config, "cameras", camera_id)})
    camera = make_devices(one, "cameras")[camera_id]
    found: Mailbox[TagDetections] = Mailbox(_KEPT)
    links: Mailbox[LinkReport] = Mailbox(_KEPT)
    lens = config.rig.cameras[camera_id].lens
    job = CameraJob(camera_id, camera, lambda: make_detector(config), clock, lens, config.refine, detections=found)
    worker = Worker(job, clock, links, lambda: None)
    worker.start()
    try:
        yield CameraEye(worker, found, links, partial(check_focus, config, camera_id))
    finally:
        worker.request_stop()
        worker.join(_JOIN_S)


def plain_head(config: RigConfig, head_id: str, found: HeadFindings | None = None) -> Head:
    """Return the head as its calibration needs it: it reports its motor, and leaves limits to who moves it.

    What was ``found`` of it already, its driver is given. Raises InputError for a driver that cannot be calibrated.
    """
    device = config.devices["heads"][head_id]
    tuning = device.driver.tuning
    if tuning is None:
        raise InputError(f"head {head_id}: its driver {device.driver_name} cannot be calibrated")
    spec = config.rig.heads[head_id]
    wide: HeadSpec = replace(
        spec,
        pan_limits_rad=(-0.5 * _FULL_TURN_RAD, 0.5 * _FULL_TURN_RAD),
        tilt_limits_rad=(-0.5 * _FULL_TURN_RAD, 0.5 * _FULL_TURN_RAD),
        speed_rad_s=_FASTER * spec.speed_rad_s,
    )
    section = device.section if found is None else device.amended(tuning.changes(device.section, found)).section
    made = device.driver.make({head_id: (wide, tuning.plain(section))})
    head: Head = made[head_id]
    return head


def reads_back(config: RigConfig, head_id: str) -> bool:
    """Tell whether a head tells its angles."""
    device = config.devices["heads"][head_id]
    return device.driver.tuning is None or device.driver.tuning.reads_back(device.section)


def run_calibration(bench: HeadBench, place: Place, tell: Tell, servo: Callable[[HeadFindings], Head]) -> HeadResult:
    """Open and enable the head, survey it, stop and close it, and return what it comes to.

    One that takes no positions is made anew by ``servo``, with roughly measured speeds, and steered by these.
    """
    rough: HeadFindings | None = None
    found = _surveyed(bench, place, tell)
    if isinstance(found, HeadFindings):
        rough, bench = found, replace(bench, head=servo(found))
        found = _surveyed(bench, place, tell)
    if isinstance(found, HeadFindings):
        raise HardwareError(f"head {bench.name} neither goes to positions nor can be steered there by its speeds")
    tell("computing", 0.95)
    return conclude(found, place, bench, rough)


def _surveyed(bench: HeadBench, place: Place, tell: Tell) -> Survey | HeadFindings:
    """Survey a head; of one that takes no positions return how fast it turns, roughly."""
    with enabled(bench.name, bench.head):
        try:
            return survey(bench, place, tell)
        except DoesNotGo:
            if bench.has_gone:  # it takes positions: something holds it now
                raise
            tell("it takes no positions: trying speeds", 0.0)
            rough = rough_speeds(bench, place.limits_rad)
            if rough is None:
                raise
            return rough


def rough_speeds(bench: HeadBench, limits_rad: Sequence[Interval]) -> HeadFindings | None:
    """Turn one axis after the other a little at some steps, slowest first, forth and back, within its limits as it
    reports; None where that is not offered or turns nothing.
    """
    if not isinstance(bench.head, TurnsByStep):
        return None
    offered = bench.head.steps()
    bounds = [_room(float(at), limits) for at, limits in zip(bench.reported_rad, limits_rad, strict=True)]
    turned: dict[str, dict[int, list[float]]] = {axis: {} for axis in AXES}
    for axis, name in enumerate(AXES):
        for share in _ROUGH_SHARES:
            step = offered[name][round(share * (len(offered[name]) - 1))]
            lasts_s = _ROUGH_S
            for signed in (step, -step):
                for run in bench.run((signed, 0) if axis == 0 else (0, signed), lasts_s, bounds):
                    lasts_s = run.ended_s - run.told_s  # no further back than forth
                    rate = float(run.reported_rad[-1] - run.reported_rad[0]) / (run.ended_s - run.told_s)
                    turned[name].setdefault(step, []).append(math.copysign(rate, rate * signed))
    axes = [_rough_axis(turned[axis]) for axis in AXES]
    if axes[0] is None or axes[1] is None:
        return None
    return HeadFindings(axes[0], axes[1], "servo")


def _room(at_rad: float, limits_rad: Interval) -> Interval:
    """Return how far an axis may be turned; less where the file counts so wrongly that its limits say nothing."""
    low, high = limits_rad
    if not low <= at_rad <= high:
        return at_rad - _BEYOND_ROOM_RAD, at_rad + _BEYOND_ROOM_RAD
    return max(low, at_rad - _ROUGH_ROOM_RAD), min(high, at_rad + _ROUGH_ROOM_RAD)


def _rough_axis(turned: Mapping[int, Sequence[float]]) -> AxisFindings | None:
    rates = {step: float(np.mean(both)) for step, both in turned.items()}
    moving = {step: abs(rate) for step, rate in rates.items() if abs(rate) > _LEAST_RATE_RAD_S}
    if not moving:
        return None
    drive: Literal[-1, 1] = 1 if sum(rates.values()) > 0.0 else -1
    return AxisFindings(1.0, 0.0, 0.0, drive=drive, speeds_rad_s=moving)


def conclude(found: Survey, place: Place, bench: HeadBench, rough: HeadFindings | None) -> HeadResult:
    """Return what a survey comes to, of a head steered by ``rough`` speeds or by positions. Raises PartialError where
    it was too little.
    """
    grade: HeadGrade = "absolute" if rough is None else "servo"
    try:
        calibrated = calibrate_head(
            with_known_flanks(found.shots), place.lens, place.sizes_m, found.start, place.anchors
        )
    except InputError as error:
        raise PartialError(str(error)) from error
    pan, tilt = (axis_timing(found.runs[axis]) for axis in AXES)
    frames = [(frame.stamp_s, bench.corners(frame)) for frame in found.frames]
    fit = calibrated.fit
    age_s = report_age(fit.model, fit.T_world_tag, place.lens, place.sizes_m, (pan, tilt), frames)
    return HeadResult(calibrated, (pan, tilt), age_s, grade, found.moving_s, tuple(found.settles_s), driven_by=rough)


def _only(config: RigConfig, group: DeviceGroup, name: str) -> dict[str, DeviceConfig]:
    return {key: device for key, device in config.devices[group].items() if key == name}
