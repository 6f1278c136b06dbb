"""Sightings of all cameras become targets: a Kalman filter each, in the order of stamps, gated. Pure."""

from camrig.fuse.settings import FLOOR, FREE, STATIC, MotionModel, Settings
from camrig.fuse.targets import Tracks, predicted_poses, targets_at, update

__all__ = [
    "FLOOR",
    "FREE",
    "STATIC",
    "MotionModel",
    "Settings",
    "Tracks",
    "predicted_poses",
    "targets_at",
    "update",
]
