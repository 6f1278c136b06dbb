"""The sections of a rig's YAML that camrig itself defines; what a driver adds is checked by the driver's own model."""

from __future__ import annotations

import math
from datetime import date
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from camrig.config.document import StrictModel
from camrig.config.units import BoxM, Degrees, FloorM, LimitsDeg, Name, Point, PoseModel, radians
from camrig.geometry.airspace import MIN_HEIGHT_M
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens.errors import TYPICAL_SIGMA, LensSigma
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_z
from camrig.optimise.scene import Objective, Quality, Visibility
from camrig.rig import (
    Anchor,
    Body,
    BodyTag,
    DroneMount,
    DroneSpec,
    FixedMount,
    FreeMount,
    HeadMount,
    HeadSpec,
    Mount,
    Space,
    TagKey,
)

TagId = Annotated[int, Field(ge=0, le=100_000)]
TagSize = Annotated[float, Field(gt=0.0, le=5.0)]


class DeviceModel(StrictModel):
    """A section whose other keys belong to its driver, which checks them."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    driver: Name

    def driver_keys(self) -> dict[str, Any]:
        """Return the keys that are the driver's."""
        return dict(self.model_extra or {})


class DetectorModel(DeviceModel):
    """How tags are found; ``refine`` takes the lens's bend out of their corners."""

    driver: Name = "pyapriltags"
    refine: bool = True


class FixedPoseModel(StrictModel):
    """Where a bolted camera stands and looks, as a level head would, then turned about its optical axis (clockwise as
    seen from behind it: the picture's contents turn the other way).
    """

    position_m: Point
    pan_deg: Degrees = 0.0
    tilt_deg: Degrees = -90.0
    roll_deg: Degrees = 0.0

    def build(self) -> Transform:
        """Return T_world_camera."""
        R = aim_rotation(math.radians(self.pan_deg), math.radians(self.tilt_deg)) @ R_MOUNT_OPTICAL
        return transform(R @ rotation_z(math.radians(self.roll_deg)), np.array(self.position_m))


class MountModel(StrictModel):
    """What carries a camera: exactly one of head, drone, fixed or free."""

    head: Name | None = None
    drone: Name | None = None
    fixed: FixedPoseModel | None = None
    free: Literal[True] | None = None
    T_mount_camera: PoseModel | None = None
    T_body_camera: PoseModel | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> MountModel:
        kinds = [name for name in ("head", "drone", "fixed", "free") if getattr(self, name) is not None]
        if len(kinds) != 1:
            raise ValueError(f"give exactly one of head, drone, fixed, free; got {', '.join(kinds) or 'none'}")
        if self.T_mount_camera and not self.head:
            raise ValueError("T_mount_camera goes with head")
        if self.T_body_camera and not self.drone:
            raise ValueError("T_body_camera goes with drone")
        return self

    def build(self) -> Mount:
        """Return the mount of the rig."""
        if self.head is not None:
            return HeadMount(self.head, _optical(self.T_mount_camera, R_MOUNT_OPTICAL))
        if self.drone is not None:
            return DroneMount(self.drone, _optical(self.T_body_camera, R_BODY_OPTICAL_DOWN))
        return FixedMount(self.fixed.build()) if self.fixed else FreeMount()


class LensSigmaModel(StrictModel):
    """One sigma of what a lens's calibration left wrong; what is not given is that of a good one."""

    f_percent: Annotated[float, Field(gt=0.0, le=5.0)] = 100.0 * TYPICAL_SIGMA[0]
    centre_px: Annotated[float, Field(gt=0.0, le=100.0)] = TYPICAL_SIGMA[1]
    k1: Annotated[float, Field(gt=0.0, le=0.1)] = TYPICAL_SIGMA[3]

    def build(self) -> LensSigma:
        """Return it as geometry.lens.errors has it."""
        return self.f_percent / 100.0, self.centre_px, self.centre_px, self.k1


class CameraModel(StrictModel):
    """One camera: which lens, which source, which mount; what its calibration left wrong, and if that is estimated;
    when its place (on a head: the head's) was calibrated.
    """

    id: Name
    lens: Name
    source: DeviceModel
    mount: MountModel
    refine_lens: bool = False
    lens_sigma: LensSigmaModel = LensSigmaModel()
    calibrated: date | None = None


class HeadModel(DeviceModel):
    """One pan-tilt head; port, baud, address and axes are its driver's."""

    id: Name
    enable: Literal["auto", "manual"] = "manual"
    position_m: Point
    rpy_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    T_arm_tilt: PoseModel = PoseModel()
    pan_deg: LimitsDeg = (-180.0, 180.0)
    tilt_deg: LimitsDeg = (-90.0, 0.0)
    speed_deg_s: Annotated[float, Field(gt=0.0, le=400.0)] = 40.0
    bias_deg: Annotated[float, Field(ge=0.0, le=5.0)] = 0.1
    needs_anchor: bool = False

    def build(self) -> HeadSpec:
        """Return the head of the rig."""
        return HeadSpec(
            id=self.id,
            kinematics=PanTilt(
                PoseModel(position_m=self.position_m, rpy_deg=self.rpy_deg).build(), self.T_arm_tilt.build()
            ),
            pan_limits_rad=radians(self.pan_deg),
            tilt_limits_rad=radians(self.tilt_deg),
            speed_rad_s=math.radians(self.speed_deg_s),
            auto_enable=self.enable == "auto",
            bias_sigma_rad=math.radians(self.bias_deg),
            needs_anchor=self.needs_anchor,
        )


class DroneModel(DeviceModel):
    """One camera drone; url, system and pose source are its driver's."""

    id: Name
    box_m: BoxM
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.8
    speed_m_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.5
    position_sigma_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    attitude_sigma_deg: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    yaw_deg: LimitsDeg | None = None
    needs_anchor: bool = False

    @model_validator(mode="after")
    def _high_enough(self) -> DroneModel:
        if self.box_m[0][2] < MIN_HEIGHT_M:
            raise ValueError(
                f"box_m starts at {self.box_m[0][2]:g} m; a drone keeps at least {MIN_HEIGHT_M:g} m height"
            )
        return self

    def build(self) -> DroneSpec:
        """Return the drone of the rig."""
        return DroneSpec(
            id=self.id,
            box_m=self.box_m,
            min_separation_m=self.min_separation_m,
            speed_m_s=self.speed_m_s,
            position_sigma_m=self.position_sigma_m,
            attitude_sigma_rad=math.radians(self.attitude_sigma_deg),
            yaw_limits_rad=None if self.yaw_deg is None else radians(self.yaw_deg),
            needs_anchor=self.needs_anchor,
        )


class BodyTagModel(StrictModel):
    """A tag on a body."""

    family: Name = "tag36h11"
    id: TagId
    size_m: TagSize
    T_body_tag: PoseModel = PoseModel()

    def build(self) -> BodyTag:
        """Return the tag of the rig."""
        return BodyTag(TagKey(self.family, self.id), self.size_m, self.T_body_tag.build())


class TargetModel(StrictModel):
    """A target: a named body with its tags, and when these were calibrated."""

    id: Name
    motion: Literal["floor", "drives", "free", "static"] = "floor"
    weight: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    height_m: Annotated[float, Field(ge=-100.0, le=100.0)] | None = None
    tags: Annotated[tuple[BodyTagModel, ...], Field(min_length=1)]
    calibrated: date | None = None

    @model_validator(mode="after")
    def _height_of_one_on_the_floor(self) -> TargetModel:
        if self.height_m is not None and self.motion not in ("floor", "drives"):
            raise ValueError("height_m goes with motion: floor or drives: what moves freely has no height of its own")
        return self

    def build(self) -> Body:
        """Return the body of the rig."""
        return Body(self.id, tuple(tag.build() for tag in self.tags), self.motion, self.weight, self.height_m)


class AnchorModel(StrictModel):
    """A tag fixed in the room."""

    family: Name = "tag36h11"
    id: TagId
    size_m: TagSize
    T_world_tag: PoseModel

    def build(self) -> Anchor:
        """Return the anchor of the rig."""
        return Anchor(TagKey(self.family, self.id), self.size_m, self.T_world_tag.build())


class SpaceModel(StrictModel):
    """Where targets live and what stands in the way."""

    floor_m: FloorM
    keep_out_m: tuple[BoxM, ...] = ()

    def build(self) -> Space:
        """Return the space of the rig."""
        return Space(self.floor_m, self.keep_out_m)


class PlannerModel(StrictModel):
    """How the rig is planned."""

    quality: Quality = "fisher"
    visibility: Visibility = "image"
    objective: Objective = "mean"
    period_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    deadline_s: Annotated[float, Field(ge=0.01, le=60.0)] = 0.5
    margin_deg: Annotated[float, Field(ge=0.0, le=20.0)] = 1.0
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.8
    max_range_m: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    min_tag_px: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    max_incidence_deg: Annotated[float, Field(gt=0.0, le=90.0)] | None = None
    gain: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    motion_cost_per_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    seed: int = 0


class FusionModel(StrictModel):
    """How the frames of all cameras become positions (fuse.Settings)."""

    estimator: Literal["joint", "covariance", "quality", "mean"] = "joint"


def _optical(pose: PoseModel | None, R_optical: Array) -> Transform:
    """Return a mount-to-camera transform: the pose as written, then the turn into the optical frame."""
    T = (pose or PoseModel()).build()
    return T @ transform(R_optical, np.zeros(3))
