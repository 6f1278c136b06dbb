"""A camera's place as a vector of kernels.problem: its limits, its frames, and aims there and back. Pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camrig.geometry.airspace import flight_box
from camrig.geometry.arrays import Array, Transform
from camrig.messages import Aim, DroneAim, HeadAim
from camrig.optimise.kernels.problem import PAN, TILT, VARIABLES, ZOOM, Z
from camrig.optimise.scene import DronePlace, FixedPlace, HeadPlace, Place, SceneCamera


class Frames(NamedTuple):
    """What of a place no variable changes: R_world_base (3, 3), T_arm_tilt and T_mount_camera (4, 4)."""

    base_R: Array
    arm: Transform
    camera: Transform


def frames(place: Place) -> Frames:
    """Return the fixed frames: a drone is a head whose pan is the yaw, a bolted camera a head that stands still."""
    match place:
        case HeadPlace(kinematics=kinematics, T_mount_camera=T_mount_camera):
            return Frames(kinematics.T_world_base[:3, :3], kinematics.T_arm_tilt, T_mount_camera)
        case DronePlace(T_body_camera=T_body_camera):
            return Frames(np.eye(3), np.eye(4), T_body_camera)
        case FixedPlace(T_world_camera=T_world_camera):
            return Frames(T_world_camera[:3, :3], np.eye(4), np.eye(4))


def bounds(place: Place) -> tuple[Array, Array]:
    """Return the (6,) lowest and highest vector; the zoom, which is the camera's, is 0 in both."""
    low, high = np.zeros(VARIABLES), np.zeros(VARIABLES)
    match place:
        case HeadPlace(kinematics=kinematics, mount_m=mount_m):
            stands = kinematics.T_world_base[:3, 3]
            low[: Z + 1], high[: Z + 1] = mount_m or (stands, stands)
            (low[PAN], high[PAN]), (low[TILT], high[TILT]) = place.pan_limits_rad, place.tilt_limits_rad
        case DronePlace(box_m=box_m, yaw_rad=yaw_rad, yaw_limits_rad=yaw_limits_rad):
            low[: Z + 1], high[: Z + 1] = flight_box(box_m)
            low[PAN], high[PAN] = yaw_limits_rad or (yaw_rad, yaw_rad)
        case FixedPlace(T_world_camera=T_world_camera):
            low[: Z + 1] = high[: Z + 1] = T_world_camera[:3, 3]
    return low, high


def vector_of(camera: SceneCamera, aim: Aim | None) -> Array | None:
    """Return the (6,) vector of an aim; None where the aim is unknown or of another kind of camera.

    A head that is still to be mounted has no vector: an aim does not say where it stands.
    """
    vector, _ = bounds(camera.place)
    match camera.place, aim:
        case HeadPlace(mount_m=None), HeadAim(pan_rad=pan_rad, tilt_rad=tilt_rad, zoom=zoom):
            vector[PAN], vector[TILT] = pan_rad, tilt_rad
            if camera.zoom:
                at = camera.zoom[0].position if zoom is None else zoom
                vector[ZOOM] = np.interp(at, [step.position for step in camera.zoom], np.arange(len(camera.zoom)))
        case DronePlace(), DroneAim(position_m=position_m, yaw_rad=yaw_rad):
            vector[: Z + 1], vector[PAN] = position_m, yaw_rad
        case FixedPlace(), _:
            pass
        case _:
            return None
    return vector


def aim_of(camera: SceneCamera, vector: Array) -> Aim | None:
    """Return the aim that a vector means; None for a fixed camera."""
    match camera.place:
        case HeadPlace():
            zoom = None
            if camera.zoom:
                positions = [step.position for step in camera.zoom]
                zoom = float(np.interp(vector[ZOOM], np.arange(len(positions)), positions))
            return HeadAim(float(vector[PAN]), float(vector[TILT]), zoom)
        case DronePlace():
            x, y, z = (float(value) for value in vector[: Z + 1])
            return DroneAim((x, y, z), float(vector[PAN]))
        case FixedPlace():
            return None
