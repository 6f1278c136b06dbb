"""A scene's YAML for ``camrig plan``: the rig's language with less in it, checked whole, and ready to be planned."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, field_validator

from camrig.config.document import Document, KeyPath, StrictModel, load_document
from camrig.config.models import FixedPoseModel, LensModel, PlannerModel, SpaceModel
from camrig.config.units import BoxM, Degrees, LimitsDeg, Metres, Name, Point, radians
from camrig.errors import ConfigError, Fault
from camrig.geometry.airspace import MIN_HEIGHT_M
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN, R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.optimise import (
    DronePlace,
    FixedPlace,
    HeadPlace,
    PlannerSettings,
    Scene,
    SceneCamera,
    SceneTarget,
)
from camrig.optimise.scene import Place
from camrig.rig import Box

ModelT = TypeVar("ModelT", bound=BaseModel)


class SceneCameraModel(StrictModel):
    """What every camera of a scene has; the subclasses add what carries it."""

    id: Name
    lens: Name
    alpha_deg: Annotated[float, Field(gt=0.0, lt=90.0)] | None = None


class HeadCameraModel(SceneCameraModel):
    """A camera on a head of its own, axes meeting in the camera."""

    mount: Literal["head"]
    position_m: Point
    pan_deg: LimitsDeg = (-180.0, 180.0)
    tilt_deg: LimitsDeg = (-90.0, 0.0)

    def place(self) -> Place:
        """Return where plans may put it."""
        kinematics = PanTilt(transform(np.eye(3), np.array(self.position_m)))
        T_mount_camera = transform(R_MOUNT_OPTICAL, np.zeros(3))
        return HeadPlace(kinematics, T_mount_camera, radians(self.pan_deg), radians(self.tilt_deg))


class DroneCameraModel(SceneCameraModel):
    """A camera that looks straight down from a drone; its yaw is not planned."""

    mount: Literal["drone"]
    box_m: BoxM
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    yaw_deg: Degrees = 0.0

    @field_validator("box_m")
    @classmethod
    def _high_enough(cls, box_m: Box) -> Box:
        if box_m[1][2] < MIN_HEIGHT_M:
            raise ValueError(f"the box ends at {box_m[1][2]:g} m; a drone keeps at least {MIN_HEIGHT_M:g} m height")
        return box_m

    def place(self) -> Place:
        """Return where plans may put it."""
        T_body_camera = transform(R_BODY_OPTICAL_DOWN, np.zeros(3))
        return DronePlace(T_body_camera, self.box_m, self.min_separation_m, math.radians(self.yaw_deg))


class FixedCameraModel(SceneCameraModel):
    """A camera bolted to the room."""

    mount: Literal["fixed"]
    position_m: Point
    pan_deg: Degrees = 0.0
    tilt_deg: Degrees = -90.0

    def place(self) -> Place:
        """Return where it is."""
        pose = FixedPoseModel(position_m=self.position_m, pan_deg=self.pan_deg, tilt_deg=self.tilt_deg)
        return FixedPlace(pose.build())


class SceneTargetModel(StrictModel):
    """A target where it is now: a point, or a tag of ``tag_size_m``."""

    id: Name
    position_m: Point
    tag_size_m: Annotated[float, Field(gt=0.0, le=5.0)] | None = None
    weight: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    normal: tuple[Metres, Metres, Metres] = (0.0, 0.0, 1.0)
    facing_deg: Degrees = 0.0

    @field_validator("normal")
    @classmethod
    def _has_length(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        if math.hypot(*normal) < 1e-6:
            raise ValueError("a normal needs a length")
        return normal

    def build(self) -> SceneTarget:
        """Return the target of the scene."""
        facing_rad = math.radians(self.facing_deg)
        return SceneTarget(self.id, self.position_m, self.tag_size_m, self.normal, facing_rad, self.weight)


class ScenePlannerModel(PlannerModel):
    """The planner's keys with a bare scene's defaults: the paper's problem."""

    visibility: Literal["image", "cone"] = "cone"
    deadline_s: Annotated[float, Field(ge=0.001, le=3600.0)] = 60.0
    margin_deg: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    min_separation_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0

    def settings(self) -> PlannerSettings:
        """Return the settings of a scene: a tag counts as seen wherever its corners are on the image."""
        return PlannerSettings(
            quality=self.quality,
            visibility=self.visibility,
            objective=self.objective,
            margin_rad=math.radians(self.margin_deg),
            min_separation_m=self.min_separation_m,
        )


@dataclass(frozen=True)
class SceneFile:
    """A scene, and how long and with which seed its file wants it planned."""

    file: str
    scene: Scene
    deadline_s: float
    seed: int

    @property
    def name(self) -> str:
        """The file's name without folder and ending."""
        return Path(self.file).stem


def load_scene(path: Path) -> SceneFile:
    """Read and check a scene's YAML; raises ConfigError with all its faults at once."""
    return _Reader(load_document(path)).read()


_CAMERA_MODELS: dict[str, type[HeadCameraModel | DroneCameraModel | FixedCameraModel]] = {
    "head": HeadCameraModel,
    "drone": DroneCameraModel,
    "fixed": FixedCameraModel,
}
_TOP_LEVEL = ("lenses", "cameras", "targets", "space", "planner")


class _Reader:
    """Reads one document section by section, so that a fault in one does not hide those of the others."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._faults: list[Fault] = []

    def read(self) -> SceneFile:
        data = self._document.data
        for key in data:
            if key not in _TOP_LEVEL:
                self._fault((key,), f"unknown key (allowed in a scene: {', '.join(_TOP_LEVEL)})")
        lenses = self._lenses()
        cameras = [self._camera(at, lenses) for at in self._items("cameras")]
        targets = [self._model(SceneTargetModel, at, self._at(at)) for at in self._items("targets")]
        for section in ("cameras", "targets"):
            self._unique(section)
        planner = self._model(ScenePlannerModel, ("planner",), data.get("planner") or {})
        space = self._model(SpaceModel, ("space",), data["space"]) if "space" in data else None
        if self._faults or planner is None:
            raise ConfigError(self._faults)
        scene = Scene(
            cameras=tuple(camera for camera in cameras if camera is not None),
            targets=tuple(target.build() for target in targets if target is not None),
            settings=planner.settings(),
            keep_out_m=space.keep_out_m if space else (),
        )
        return SceneFile(self._document.file, scene, planner.deadline_s, planner.seed)

    def _lenses(self) -> dict[str, LensModel | None]:
        section = self._document.data.get("lenses")
        if not isinstance(section, dict) or not section:
            self._fault(("lenses",), "must be a mapping with at least one lens")
            return {}
        return {str(name): self._model(LensModel, ("lenses", name), lens) for name, lens in section.items()}

    def _camera(self, at: KeyPath, lenses: dict[str, LensModel | None]) -> SceneCamera | None:
        data = self._at(at)
        mount = data.get("mount") if isinstance(data, dict) else None
        kind = _CAMERA_MODELS.get(mount) if isinstance(mount, str) else None
        if kind is None:
            self._fault((*at, "mount"), f"must be one of {', '.join(_CAMERA_MODELS)}; got {mount!r}")
            return None
        model = self._model(kind, at, data)
        if model is None:
            return None
        if model.lens not in lenses:
            self._fault((*at, "lens"), f"there is no lens '{model.lens}'; this file defines: {', '.join(lenses)}")
        lens = lenses.get(model.lens)
        alpha_rad = None if model.alpha_deg is None else math.radians(model.alpha_deg)
        return None if lens is None else SceneCamera(model.id, lens.build(), model.place(), alpha_rad)

    def _items(self, key: str) -> list[KeyPath]:
        section = self._document.data.get(key)
        if not isinstance(section, list) or not section:
            self._fault((key,), f"must be a list with at least one of the {key}")
            return []
        return [(key, index) for index in range(len(section))]

    def _unique(self, key: str) -> None:
        first: dict[object, int] = {}
        for at in self._items(key) if isinstance(self._document.data.get(key), list) else []:
            data = self._at(at)
            name = data.get("id") if isinstance(data, dict) else None
            if isinstance(name, str) and first.setdefault(name, int(at[1])) != at[1]:
                self._fault((*at, "id"), f"'{name}' is already the id of {key}[{first[name]}]; ids are unique")

    def _model(self, model: type[ModelT], at: KeyPath, data: object) -> ModelT | None:
        found, faults = self._document.validate(model, data, at)
        self._faults += faults
        return found

    def _at(self, at: KeyPath) -> Any:
        node: Any = self._document.data
        for key in at:
            node = node[key]
        return node

    def _fault(self, at: KeyPath, message: str) -> None:
        self._faults.append(self._document.fault(at, message))
