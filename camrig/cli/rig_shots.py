"""Pictures from a rig's own cameras, taken now: what ``camrig calibrate check`` looks at. Nothing moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from camrig.calibrate.sighted import Shot
from camrig.cli.calibration_pictures import usable_tags
from camrig.cli.console import people, progress_bar
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig
from camrig.detect import detect_tags, warm_up
from camrig.errors import HardwareError
from camrig.interfaces import Camera, Head
from camrig.rig import HeadMount
from camrig.runtime.build import make_detector, make_devices
from camrig.runtime.emulated import emulated_world

PICTURES = 5
"""Of each camera."""

_PICTURE_S, _ANSWER_S, _ANSWERS = 5.0, 0.5, 10

Aim = tuple[float, float]


def rig_shots(config: RigConfig, *, hidden: bool) -> tuple[list[Shot], list[str]]:
    """Take some pictures with each fixed camera and each on a head that says its angles; return what tags they show,
    and a sentence for each camera that could not be used.
    """
    if config.refine:
        with people.status("loading refinement; after an installation it is compiled once, for a quarter of a minute"):
            warm_up()
    with emulated_world(config) as (started, _):
        aims, faults = _aims(started)
        cameras = make_devices(started, "cameras")
        shots: list[Shot] = []
        with progress_bar("looking", PICTURES * len(cameras), hidden=hidden) as progress:
            for name, camera in cameras.items():
                aim = aims.get(name)
                if isinstance(started.rig.cameras[name].mount, HeadMount) and aim is None:
                    continue
                try:
                    for shot in _shots(started, name, camera, aim):
                        shots.append(shot)
                        progress.advance(progress.task_ids[0])
                except HardwareError as error:
                    faults.append(str(error))
    return shots, faults


def _shots(config: RigConfig, name: str, camera: Camera, aim_rad: Aim | None) -> Iterator[Shot]:
    detector, lens = make_detector(config), config.rig.cameras[name].lens
    with _open(camera):
        for k in range(PICTURES):
            frame = camera.read(_PICTURE_S)
            if frame is None:
                raise HardwareError(f"camera {name} opened and gave no picture within {_PICTURE_S:.0f} s")
            found = detect_tags(frame, detector, RealClock().now_s, lens=lens if config.refine else None)
            yield Shot(name, k, usable_tags(found.tags, lens), aim_rad=aim_rad)


def _aims(config: RigConfig) -> tuple[dict[str, Aim], list[str]]:
    """Return where the head of each camera says that it points; reads, and moves nothing."""
    heads: Mapping[str, Head] = make_devices(config, "heads")
    aims: dict[str, Aim] = {}
    faults: list[str] = []
    for camera in config.rig.cameras.values():
        if not isinstance(camera.mount, HeadMount):
            continue
        try:
            with _open(heads[camera.mount.head]):
                aim = _aim(heads[camera.mount.head])
        except HardwareError as error:
            faults.append(str(error))
            continue
        if aim is None:
            faults.append(f"head {camera.mount.head} does not say where it points: {camera.id} cannot be checked")
        else:
            aims[camera.id] = aim
    return aims, faults


def _aim(head: Head) -> Aim | None:
    angles: dict[str, float] = {}
    for _ in range(_ANSWERS):
        angles |= {reading.axis: reading.angle_rad for reading in head.read(_ANSWER_S)}
        if len(angles) == 2:
            return angles["pan"], angles["tilt"]
    return None


@contextmanager
def _open(device: Camera | Head) -> Iterator[None]:
    with ExitStack() as stack:
        stack.callback(device.close)
        device.open()
        yield
