"""A head calibrated with its own devices: opened, enabled, moved, and stopped however it ends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from camrig.calibrate.head import calibrate_head, with_known_flanks
from camrig.calibrate.head_result import AXES, HeadResult
from camrig.calibrate.head_timing import axis_timing, report_age
from camrig.clock import Clock
from camrig.config.rig_file import DeviceConfig, DeviceGroup, RigConfig
from camrig.errors import HardwareError, InputError, PartialError
from camrig.interfaces import Head
from camrig.messages import HeadGrade, LinkReport, LinkStatus, TagDetections
from camrig.rig import HeadSpec
from camrig.runtime.build import make_detector, make_devices
from camrig.runtime.camera_job import CameraJob
from camrig.runtime.head_bench import Eye, HeadBench
from camrig.runtime.head_survey import Place, Survey, Tell, survey
from camrig.runtime.mailbox import Mailbox
from camrig.runtime.worker import Worker

_KEPT = 256
_JOIN_S = 3.0
_FULL_TURN_RAD = 6.28
_FASTER = 3.0
"""A file's speed may be so far below the truth, in the angles that its counting makes of it."""


@dataclass
class CameraEye:
    """``Eye``: one camera's worker and what it found."""

    worker: Worker
    found: Mailbox[TagDetections]
    links: Mailbox[LinkReport]
    failed: list[str] = field(default_factory=list)

    def take(self) -> Sequence[TagDetections]:
        for report in self.links.take_all():
            if report.status is LinkStatus.LOST:
                raise HardwareError(f"camera {report.device_id} is lost: {report.reason}")
        if self.worker.failed is not None:
            raise HardwareError(f"camera {self.worker.job.name} failed: {self.worker.failed}")
        return self.found.take_all()


@contextmanager
def camera_eye(config: RigConfig, camera_id: str, clock: Clock) -> Iterator[Eye]:
    """Run one camera's worker while inside; it opens and closes the camera."""
    one = replace(config, devices={**config.devices, "cameras": _only(config, "cameras", camera_id)})
    camera = make_devices(one, "cameras")[camera_id]
    found: Mailbox[TagDetections] = Mailbox(_KEPT)
    links: Mailbox[LinkReport] = Mailbox(_KEPT)
    lens = config.rig.cameras[camera_id].lens
    job = CameraJob(camera_id, camera, lambda: make_detector(config), clock, lens, config.refine, detections=found)
    worker = Worker(job, clock, links, lambda: None)
    worker.start()
    try:
        yield CameraEye(worker, found, links)
    finally:
        worker.request_stop()
        worker.join(_JOIN_S)


def plain_head(config: RigConfig, head_id: str) -> Head:
    """Return the head as its calibration needs it: it reports its motor, and leaves limits to who moves it."""
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
    made = device.driver.make({head_id: (wide, tuning.plain(device.section))})
    head: Head = made[head_id]
    return head


def run_calibration(bench: HeadBench, place: Place, grade: HeadGrade, tell: Tell) -> HeadResult:
    """Open and enable the head, survey it, stop and close it, and return what it comes to."""
    bench.head.open()
    try:
        bench.head.enable()
        found = survey(bench, place, tell)
    finally:
        bench.head.stop()
        bench.head.close()
    tell("computing", 0.95)
    return conclude(found, place, bench, grade)


def conclude(found: Survey, place: Place, bench: HeadBench, grade: HeadGrade) -> HeadResult:
    """Return what a survey comes to. Raises PartialError where it was too little."""
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
    return HeadResult(calibrated, (pan, tilt), age_s, grade, found.moving_s, tuple(found.settles_s))


def _only(config: RigConfig, group: DeviceGroup, name: str) -> dict[str, DeviceConfig]:
    return {key: device for key, device in config.devices[group].items() if key == name}
