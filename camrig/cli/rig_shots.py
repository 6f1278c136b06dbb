"""Pictures from a rig's own cameras, taken now: what ``camrig calibrate check`` looks at. Nothing moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from camrig.calibrate.sighted import Shot
from camrig.cli.calibration_pictures import usable_tags
from camrig.cli.console import progress_bar
from camrig.cli.refinement import load_refinement
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig
from camrig.detect import detect_tags
from camrig.errors import HardwareError
from camrig.interfaces import Camera, Head
from camrig.rig import FixedMount, HeadMount
from camrig.runtime.build import make_detector, make_devices
from camrig.runtime.emulated import emulated_world

PICTURES = 5
"""Of each camera."""

_SPAN_S = 2.0
_PICTURE_S, _ANSWER_S, _ANSWERS = 5.0, 0.5, 10

Aim = tuple[float, float]


def rig_shots(config: RigConfig, *, hidden: bool) -> tuple[list[Shot], list[str]]:
    """Take some pictures with each fixed camera and each on a head that says its angles; return what tags they show,
    and a sentence for each camera that could not be used.

    Cameras take turns for ``_SPAN_S``, so that what moves is seen to.
    """
    if config.refine:
        load_refinement()
    clock = RealClock()
    shots: list[Shot] = []
    with emulated_world(config) as (started, _), ExitStack() as stack:
        aims, faults = _aims(started)
        cameras = {
            name: _Looking(started, name, aims.get(name)) for name in started.rig.cameras if _rests(started, name, aims)
        }
        devices: Mapping[str, Camera] = make_devices(started, "cameras")
        with progress_bar("looking", PICTURES * len(cameras), hidden=hidden) as progress:
            lost: set[str] = set()
            begun_s = clock.now_s()
            for turn in range(PICTURES):
                for name, looking in cameras.items():
                    progress.advance(progress.task_ids[0])
                    try:
                        if turn == 0:
                            stack.callback(devices[name].close)
                            devices[name].open()
                        if name not in lost:
                            shots.append(looking.shot(devices[name], turn, begun_s + turn * _SPAN_S / PICTURES))
                    except HardwareError as error:
                        lost.add(name)
                        faults.append(str(error))
    return shots, faults


def _rests(config: RigConfig, name: str, aims: Mapping[str, Aim]) -> bool:
    """Tell whether it is known where a camera is."""
    mount = config.rig.cameras[name].mount
    return isinstance(mount, FixedMount) or (isinstance(mount, HeadMount) and name in aims)


class _Looking:
    """Looks for tags with one camera."""

    def __init__(self, config: RigConfig, name: str, aim_rad: Aim | None) -> None:
        self._name, self._aim_rad, self._refine = name, aim_rad, config.refine
        self._lens, self._detector = config.rig.cameras[name].lens, make_detector(config)

    def shot(self, camera: Camera, turn: int, from_s: float) -> Shot:
        """Return what the first picture after ``from_s`` shows; raises HardwareError where none comes."""
        clock = RealClock()
        frame = camera.read(_PICTURE_S)
        while frame is not None and clock.now_s() < from_s:
            frame = camera.read(_PICTURE_S)
        if frame is None:
            raise HardwareError(f"camera {self._name} opened and gave no picture within {_PICTURE_S:.0f} s")
        found = detect_tags(frame, self._detector, clock.now_s, lens=self._lens if self._refine else None)
        return Shot(self._name, turn, usable_tags(found.tags, self._lens), aim_rad=self._aim_rad)


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
def _open(device: Head) -> Iterator[None]:
    with ExitStack() as stack:
        stack.callback(device.close)
        device.open()
        yield
