"""Where a drone is by the anchors that its camera sees, and by nothing else: what is sent to its autopilot.

The autopilot makes its position of these poses. Its telemetry is then no second opinion: mixed with the anchors again,
the same news would count twice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camrig.geometry.arrays import Transform
from camrig.geometry.pose import PosePriors, compose, inverse_covariance_pose, invert, transform
from camrig.geometry.rotation import rotation_z, yaw_of
from camrig.locate.anchors import Belief, from_anchors_alone
from camrig.locate.camera_pose import MOUNT_COVARIANCE
from camrig.locate.tags import owners, undistorted, without_repeats
from camrig.messages import BodyPose, TagDetections
from camrig.rig import DroneMount, Rig

TILT_RAD = 0.08
"""One sigma of a hovering drone's roll and pitch: it tilts by its acceleration over gravity."""
VAGUE_M, VAGUE_RAD = 100.0, 10.0
"""So much as nothing."""


def navigates_by(camera_id: str, rig: Rig) -> str | None:
    """Return the drone that navigates by what this camera sees, or None."""
    match rig.cameras[camera_id].mount:
        case DroneMount(drone=name) if rig.drones[name].needs_anchor:
            return name
    return None


def hovering(mount: DroneMount) -> Belief:
    """Return what is known of the camera under a drone wherever it is: that the drone is nearly level.

    This decides between the two poses that a single tag seen from above often leaves open.
    """
    covariance = np.diag([VAGUE_M**2] * 3 + [TILT_RAD**2] * 2 + [VAGUE_RAD**2])

    def belief(starts: Sequence[Transform]) -> PosePriors:
        levelled = [_levelled(invert(mount.T_body_camera @ T_camera_world)) for T_camera_world in starts]
        cameras = [compose(T, covariance, mount.T_body_camera, np.zeros((6, 6))) for T in levelled]
        priors = [inverse_covariance_pose(*camera) for camera in cameras]
        information = [np.linalg.inv(C) for _, C in priors]
        return PosePriors(np.stack([T for T, _ in priors]), np.stack(information))

    return belief


def _levelled(T_world_body: Transform) -> Transform:
    return transform(rotation_z(yaw_of(T_world_body[:3, :3])), T_world_body[:3, 3])


def body_pose(detections: TagDetections, rig: Rig) -> BodyPose | None:
    """Return the pose of the drone that carries the camera; None without anchors, or where they leave two to choose."""
    camera = rig.cameras[detections.camera_id]
    if not isinstance(camera.mount, DroneMount) or detections.size_px != camera.lens.size_px:
        return None
    known = owners(rig)
    listed = [(tag, known[tag.key]) for tag in detections.tags if tag.key in known]
    anchors, _ = without_repeats(
        undistorted(camera.lens, [(tag, owner) for tag, owner in listed if owner.target_id is None]), lambda _: None
    )
    found = from_anchors_alone(camera.id, detections.stamp_s, anchors, hovering(camera.mount)).pose
    if found is None:
        return None
    T_camera_body, covariance = inverse_covariance_pose(camera.mount.T_body_camera, MOUNT_COVARIANCE)
    T_world_body, covariance = compose(found.T_world_camera, found.covariance, T_camera_body, covariance)
    return BodyPose(camera.mount.drone, detections.stamp_s, T_world_body, covariance)
