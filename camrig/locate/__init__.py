"""Tag detections and the camera's pose at the frame's stamp give sightings of targets, with covariance. Pure."""

from camrig.locate.body_pose import body_pose, navigates_by
from camrig.locate.camera_pose import camera_pose
from camrig.locate.drift import Drift, with_correction
from camrig.locate.head_angles import with_offset
from camrig.locate.history import AxisHistory, DroneHistory, HeadHistory, HeadState, Histories
from camrig.locate.joint import joint, warm_up
from camrig.locate.lenses import AS_CALIBRATED, Lenses, Refined
from camrig.locate.one_frame import Located, locate
from camrig.locate.views import Together, View, apart

__all__ = [
    "AS_CALIBRATED",
    "AxisHistory",
    "Drift",
    "DroneHistory",
    "HeadHistory",
    "HeadState",
    "Histories",
    "Lenses",
    "Located",
    "Refined",
    "Together",
    "View",
    "apart",
    "body_pose",
    "camera_pose",
    "joint",
    "locate",
    "navigates_by",
    "warm_up",
    "with_correction",
    "with_offset",
]
