"""The frozen messages that flow through camrig, in the order in which they arise: measured, located, planned.

Stamps are seconds of the one monotonic clock. Every position comes with its covariance; ``None`` is "unknown".
"""

from camrig.messages.events import (
    Event,
    Level,
)
from camrig.messages.located import (
    CameraPose,
    Sighting,
    Target,
    TargetStatus,
)
from camrig.messages.measured import (
    AxisReading,
    DroneReading,
    Expected,
    FlightState,
    Frame,
    LinkReport,
    LinkStatus,
    Region,
    TagDetection,
    TagDetections,
)
from camrig.messages.planned import (
    Aim,
    Command,
    DroneAim,
    DroneCommand,
    HeadAim,
    HeadCommand,
    LostTarget,
    PlannerAnswer,
    PlannerRequest,
    PlanRequest,
    PlanStatus,
    PlanTarget,
    RigPlan,
    RigPose,
    ScanPlan,
    ScanRequest,
    TargetQuality,
)

__all__ = [
    "Aim",
    "AxisReading",
    "CameraPose",
    "Command",
    "DroneAim",
    "DroneCommand",
    "DroneReading",
    "Event",
    "Expected",
    "FlightState",
    "Frame",
    "HeadAim",
    "HeadCommand",
    "Level",
    "LinkReport",
    "LinkStatus",
    "LostTarget",
    "PlanRequest",
    "PlanStatus",
    "PlanTarget",
    "PlannerAnswer",
    "PlannerRequest",
    "Region",
    "RigPlan",
    "RigPose",
    "ScanPlan",
    "ScanRequest",
    "Sighting",
    "TagDetection",
    "TagDetections",
    "Target",
    "TargetQuality",
    "TargetStatus",
]
