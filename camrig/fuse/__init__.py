"""Fixes become targets: a Kalman filter each, in the order of stamps, gated. Pure."""

from camrig.fuse.settings import DRIVES, FLOOR, FREE, STATIC, Estimator, MotionModel, Settings
from camrig.fuse.targets import Tracks, motions, predicted_poses, targets_at, update

__all__ = [
    "DRIVES",
    "FLOOR",
    "FREE",
    "STATIC",
    "Estimator",
    "MotionModel",
    "Settings",
    "Tracks",
    "motions",
    "predicted_poses",
    "targets_at",
    "update",
]
