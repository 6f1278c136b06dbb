"""What the cameras of a drawn room see: pictures through their true lenses, and the tags that camrig finds in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from camrig import plugins
from camrig.detect import detect_tags
from camrig.experiments.rooms import FAMILY, Room, body_pose
from camrig.geometry.arrays import GreyImage, Transform
from camrig.geometry.pose import apply, invert
from camrig.interfaces import Painter, TagDetector
from camrig.locate import Histories
from camrig.locate.tags import owners
from camrig.messages import (
    Aim,
    AxisReading,
    DroneAim,
    DroneReading,
    FlightState,
    Frame,
    HeadAim,
    TagDetection,
    TagDetections,
)
from camrig.rig import TagKey

STAMP_S = 1.0
"""When every picture of a room is taken."""
_READING_RAD = 1e-5
_DETECTOR = "pyapriltags"
_PAINTER = "emulated"


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """One camera's picture, its tags with the detector's corners and with those refined through the believed lens, and
    which tags are wholly in it.
    """

    image: GreyImage
    detected: TagDetections
    refined: TagDetections
    in_picture: frozenset[TagKey]


def photograph(room: Room, camera_id: str, aim: Aim) -> Photograph:
    """Take the picture of a camera at an aim; its noise depends on the room's seed and the camera alone."""
    camera, true_lens = room.rig.cameras[camera_id], room.errors[camera_id].lens
    T_world_camera = room.true_pose(camera_id, aim)
    number = tuple(room.rig.cameras).index(camera_id)
    seed = 100 * room.place.seed + number
    image = painter().paint(room.rig, true_lens, lambda _: (T_world_camera, room.bodies), seed)
    frame = Frame(camera_id, image, STAMP_S, 0)
    detected = detect_tags(frame, detector(), lambda: 0.0)
    refined = detect_tags(frame, _Known(detected.tags), lambda: 0.0, lens=camera.lens)
    return Photograph(image, detected, refined, _in_picture(room, camera_id, T_world_camera))


@cache
def painter(noise_grey: float = 4.0, psf_px: float = 0.7, exposure_s: float = 0.002) -> Painter:
    """Return this process's painter of such pictures. Raises InputError for a missing plug-in."""
    plugin = plugins.load_plugin("painters", _PAINTER)
    made: Painter = plugin.make(plugin.section(noise_grey=noise_grey, psf_px=psf_px, exposure_s=exposure_s))
    return made


@cache
def detector() -> TagDetector:
    """Return this process's: a detector is kept as long as its process. Raises InputError for a missing plug-in."""
    plugin = plugins.load_plugin("detectors", _DETECTOR)
    made: TagDetector = plugin.make(plugin.section(families=(FAMILY,), decimate=1.0))
    return made


@dataclass(frozen=True, slots=True)
class _Known:
    """A detector that has looked already: its corners are refined without searching the picture again."""

    tags: tuple[TagDetection, ...]

    def detect(self, image: GreyImage) -> tuple[TagDetection, ...]:
        del image
        return self.tags


def histories(room: Room, aims: Mapping[str, Aim]) -> Histories:
    """Return what heads and drones say at the time of the pictures: that they are at their aims."""
    found = Histories()
    for name, aim in aims.items():
        match aim:
            case HeadAim(pan_rad=pan_rad, tilt_rad=tilt_rad):
                found = found.with_reading(AxisReading(name, "pan", pan_rad, STAMP_S, _READING_RAD, 0.0))
                found = found.with_reading(AxisReading(name, "tilt", tilt_rad, STAMP_S, _READING_RAD, 0.0))
            case DroneAim():
                drone = room.rig.drones[name]
                sigmas = [drone.position_sigma_m] * 3 + [drone.attitude_sigma_rad] * 3
                covariance = np.diag(np.square(sigmas))
                reading = DroneReading(name, STAMP_S, body_pose(aim), covariance, FlightState.FLYING)
                found = found.with_reading(reading)
    return found


def _in_picture(room: Room, camera_id: str, T_world_camera: Transform) -> frozenset[TagKey]:
    """Return the tags that face the camera and lie in its picture with all four corners."""
    lens = room.errors[camera_id].lens
    low, high = np.zeros(2), np.asarray(lens.size_px) - 1.0
    found = set()
    for key, owner in owners(room.rig).items():
        T_world_tag = (np.eye(4) if owner.target_id is None else room.bodies[owner.target_id]) @ owner.T_owner_tag
        T_camera_tag = invert(T_world_camera) @ T_world_tag
        corners_px = lens.project(
            apply(invert(T_world_camera) @ T_world_tag @ invert(owner.T_owner_tag), owner.corners_m)
        )
        facing = float(T_camera_tag[:3, 2] @ T_camera_tag[:3, 3]) < 0.0
        if facing and bool(((corners_px >= low) & (corners_px <= high)).all()):
            found.add(key)
    return frozenset(found)
