"""The sections of a scene's YAML: cameras by what carries them, targets, anchors, the planner."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from camrig.config.document import StrictModel
from camrig.config.models import FixedPoseModel, PlannerModel, TagSize
from camrig.config.units import BoxM, Degrees, LimitsDeg, Metres, Name, Point, SurfaceM, YawDeg, radians
from camrig.geometry.airspace import MIN_HEIGHT_M
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.optimise import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    PoseSigma,
    SceneAnchor,
    SceneTarget,
)
from camrig.optimise.scene import Quality, Visibility
from camrig.rig import Box

Millimetres = Annotated[float, Field(ge=0.001, le=1000.0)]
Attitude = Annotated[float, Field(ge=0.0001, le=10.0)]
AxisBias = Annotated[float, Field(ge=0.0, le=5.0)]


class PoseSigmaModel(StrictModel):
    """One sigma of a pose: place and turn; the defaults are a bolted camera's."""

    position_mm: Millimetres = 1.0
    attitude_deg: Attitude = math.degrees(0.0005)

    def build(self) -> PoseSigma:
        """Return the sigma of the scene."""
        return PoseSigma(self.position_mm / 1000.0, math.radians(self.attitude_deg))


class HeadSigmaModel(PoseSigmaModel):
    """One sigma of a head's camera: that of its mounting, and of what the head's angles are off by."""

    pan_deg: AxisBias = 0.1
    tilt_deg: AxisBias = 0.1

    def build(self) -> PoseSigma:
        """Return the sigma of the scene."""
        turn_rad = math.radians(self.attitude_deg)
        return PoseSigma(self.position_mm / 1000.0, turn_rad, math.radians(self.pan_deg), math.radians(self.tilt_deg))


class DroneSigmaModel(PoseSigmaModel):
    """One sigma of a drone's camera: what its own estimate is off by."""

    position_mm: Millimetres = 30.0
    attitude_deg: Attitude = 1.0


class SceneCameraModel(StrictModel):
    """What every camera of a scene has; the subclasses add what carries it."""

    id: Name
    lens: Name
    alpha_deg: Annotated[float, Field(gt=0.0, lt=90.0)] | None = None
    needs_anchor: bool = False
    pose_sigma: PoseSigmaModel = PoseSigmaModel()


class HeadCameraModel(SceneCameraModel):
    """A camera on a head of its own, axes meeting in the camera; on a surface, plans also choose where."""

    mount: Literal["head"]
    position_m: Point | None = None
    surface_m: SurfaceM | None = None
    pan_deg: LimitsDeg = (-180.0, 180.0)
    tilt_deg: LimitsDeg = (-90.0, 0.0)
    pose_sigma: HeadSigmaModel = HeadSigmaModel()

    @model_validator(mode="after")
    def _stands_somewhere(self) -> HeadCameraModel:
        if (self.position_m is None) == (self.surface_m is None):
            raise ValueError(
                "a head has a position_m, or a surface_m on which plans choose it: give exactly one of them"
            )
        return self

    def place(self) -> HeadPlace:
        """Return where plans may put it."""
        stands_m = self.position_m if self.surface_m is None else np.mean(self.surface_m, axis=0)
        kinematics = PanTilt(transform(np.eye(3), np.array(stands_m)))
        T_mount_camera = transform(R_MOUNT_OPTICAL, np.zeros(3))
        return HeadPlace(kinematics, T_mount_camera, radians(self.pan_deg), radians(self.tilt_deg), self.surface_m)


class DroneCameraModel(SceneCameraModel):
    """A camera that looks straight down from a drone; of two yaws, plans choose one between them."""

    mount: Literal["drone"]
    box_m: BoxM
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    yaw_deg: YawDeg = 0.0
    pose_sigma: DroneSigmaModel = DroneSigmaModel()

    @field_validator("box_m")
    @classmethod
    def _high_enough(cls, box_m: Box) -> Box:
        if box_m[1][2] < MIN_HEIGHT_M:
            raise ValueError(f"the box ends at {box_m[1][2]:g} m; a drone keeps at least {MIN_HEIGHT_M:g} m height")
        return box_m

    def place(self) -> DronePlace:
        """Return where plans may put it."""
        T_body_camera = transform(R_BODY_OPTICAL_DOWN, np.zeros(3))
        if isinstance(self.yaw_deg, tuple):
            limits_rad = radians(self.yaw_deg)
            return DronePlace(T_body_camera, self.box_m, self.min_separation_m, limits_rad[0], limits_rad)
        return DronePlace(T_body_camera, self.box_m, self.min_separation_m, math.radians(self.yaw_deg))


class FixedCameraModel(SceneCameraModel):
    """A camera bolted to the room."""

    mount: Literal["fixed"]
    position_m: Point
    pan_deg: Degrees = 0.0
    tilt_deg: Degrees = -90.0

    def place(self) -> FixedPlace:
        """Return where it is."""
        pose = FixedPoseModel(position_m=self.position_m, pan_deg=self.pan_deg, tilt_deg=self.tilt_deg)
        return FixedPlace(pose.build())


AnyCameraModel = HeadCameraModel | DroneCameraModel | FixedCameraModel


class PlacedModel(StrictModel):
    """What targets and anchors have in common: where they are and which way they face."""

    position_m: Point
    normal: tuple[Metres, Metres, Metres] = (0.0, 0.0, 1.0)
    facing_deg: Degrees = 0.0

    @field_validator("normal")
    @classmethod
    def _has_length(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        if math.hypot(*normal) < 1e-6:
            raise ValueError("a normal needs a length")
        return normal


class SceneTargetModel(PlacedModel):
    """A target where it is now: a point, or a tag of ``tag_size_m``."""

    id: Name
    tag_size_m: TagSize | None = None
    weight: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0

    def build(self) -> SceneTarget:
        """Return the target of the scene."""
        facing_rad = math.radians(self.facing_deg)
        return SceneTarget(self.id, self.position_m, self.tag_size_m, self.normal, facing_rad, self.weight)


class SceneAnchorModel(PlacedModel):
    """A tag fixed in the room."""

    tag_size_m: TagSize

    def build(self) -> SceneAnchor:
        """Return the anchor of the scene."""
        return SceneAnchor(self.position_m, self.tag_size_m, self.normal, math.radians(self.facing_deg))


class ScenePlannerModel(PlannerModel):
    """The planner's keys with a bare scene's defaults: the paper's problem."""

    quality: Quality = "pixel"
    visibility: Visibility = "cone"
    deadline_s: Annotated[float, Field(ge=0.001, le=3600.0)] = 60.0
    margin_deg: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0

    def settings(self) -> PlannerSettings:
        """Return the settings of a scene: a tag counts as seen wherever its corners are on the image, unless asked."""
        return PlannerSettings(
            quality=self.quality,
            visibility=self.visibility,
            objective=self.objective,
            margin_rad=math.radians(self.margin_deg),
            min_separation_m=self.min_separation_m,
            min_tag_px=self.min_tag_px or 0.0,
            max_incidence_rad=math.radians(self.max_incidence_deg or 90.0),
            max_range_m=self.max_range_m or math.inf,
            motion_cost_per_s=self.motion_cost_per_s,
        )
