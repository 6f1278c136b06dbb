"""A scene's YAML for ``camrig plan``: the rig's language with less in it, checked whole, and ready to be planned."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from camrig.config.document import KeyPath, load_document
from camrig.config.lenses import AnyLensModel, LensModel
from camrig.config.models import SpaceModel
from camrig.config.scene_models import (
    AnyCameraModel,
    DroneCameraModel,
    FixedCameraModel,
    HeadCameraModel,
    SceneAnchorModel,
    ScenePlannerModel,
    SceneTargetModel,
)
from camrig.config.sections import Sections, repeated_ids
from camrig.errors import ConfigError
from camrig.optimise import Scene, SceneCamera, ZoomStep
from camrig.optimise.scene import Quality


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


def load_scene(path: Path, quality: Quality | None = None) -> SceneFile:
    """Read and check a scene's YAML; ``quality`` counts instead of the file's own.

    Raises ConfigError with all faults of the file at once.
    """
    return _Reader(Sections(load_document(path)), quality).read()


_CAMERA_MODELS: dict[str, type[AnyCameraModel]] = {
    "head": HeadCameraModel,
    "drone": DroneCameraModel,
    "fixed": FixedCameraModel,
}
_TOP_LEVEL = ("lenses", "cameras", "targets", "anchors", "space", "planner")


@dataclass
class _Reader:
    """Reads the sections of one document, and what only several of them together show."""

    file: Sections
    quality: Quality | None

    def read(self) -> SceneFile:
        file, data = self.file, self.file.document.data
        for key in data:
            if key not in _TOP_LEVEL:
                file.fault((key,), f"unknown key (allowed in a scene: {', '.join(_TOP_LEVEL)})")
        lenses = file.lenses()
        cameras = {at: camera for at in file.places("cameras", required=True) if (camera := self._camera(at))}
        targets = file.items(SceneTargetModel, "targets", required=True)
        anchors = file.items(SceneAnchorModel, "anchors")
        planner = file.checked(ScenePlannerModel, data.get("planner") or {}, ("planner",))
        space = file.model(SpaceModel, ("space",))
        for section in ("cameras", "targets"):
            for at, message in repeated_ids(data, section):
                file.fault(at, message)
        self._lenses_fit(cameras, lenses)
        self._have_anchors(cameras)
        if planner is not None and self.quality is not None:
            planner = planner.model_copy(update={"quality": self.quality})
        if planner is not None and planner.quality == "fisher":
            self._have_tags(targets)
        if file.faults or planner is None:
            raise ConfigError(file.faults)
        scene = Scene(
            cameras=tuple(_build(camera, lenses[camera.lens]) for camera in cameras.values()),
            targets=tuple(target.build() for target in targets.values()),
            settings=planner.settings(),
            keep_out_m=space.keep_out_m if space else (),
            anchors=tuple(anchor.build() for anchor in anchors.values()),
        )
        return SceneFile(file.document.file, scene, planner.deadline_s, planner.seed)

    def _camera(self, at: KeyPath) -> AnyCameraModel | None:
        data = self.file.node(at)
        mount = data.get("mount") if isinstance(data, dict) else None
        kind = _CAMERA_MODELS.get(mount) if isinstance(mount, str) else None
        if kind is None:
            self.file.fault((*at, "mount"), f"must be one of {', '.join(_CAMERA_MODELS)}; got {mount!r}")
            return None
        return self.file.checked(kind, data, at)

    def _lenses_fit(self, cameras: Mapping[KeyPath, AnyCameraModel], lenses: Mapping[str, AnyLensModel]) -> None:
        written = self.file.document.data.get("lenses")
        for at, camera in cameras.items():
            if isinstance(written, dict) and camera.lens not in written:
                listed = ", ".join(written)
                self.file.fault((*at, "lens"), f"there is no lens '{camera.lens}'; this file defines: {listed}")
            if camera.lens not in lenses or isinstance(lenses[camera.lens], LensModel):
                continue
            if camera.mount != "head":
                message = f"'{camera.lens}' is a zoom lens, and plans choose the zoom of cameras with mount head only"
                self.file.fault((*at, "lens"), message)
            if camera.alpha_deg is not None:
                message = (
                    f"goes with a lens of one focal length; the angle of zoom lens '{camera.lens}' follows its zoom"
                )
                self.file.fault((*at, "alpha_deg"), message)

    def _have_anchors(self, cameras: Mapping[KeyPath, AnyCameraModel]) -> None:
        if self.file.document.data.get("anchors"):
            return
        for at, camera in cameras.items():
            if camera.needs_anchor:
                message = f"'{camera.id}' must keep an anchor in view, and this file lists no anchors"
                self.file.fault((*at, "needs_anchor"), message)

    def _have_tags(self, targets: Mapping[KeyPath, SceneTargetModel]) -> None:
        for at, target in targets.items():
            if target.tag_size_m is None:
                self.file.fault((*at, "tag_size_m"), "is missing; quality 'fisher' judges by the corners of a tag")


def _build(model: AnyCameraModel, lens: AnyLensModel) -> SceneCamera:
    zoom = () if isinstance(lens, LensModel) else tuple(ZoomStep(at, built) for at, built in lens.build())
    return SceneCamera(
        id=model.id,
        lens=lens.build() if isinstance(lens, LensModel) else zoom[0].lens,
        place=model.place(),
        alpha_rad=None if model.alpha_deg is None else math.radians(model.alpha_deg),
        pose_sigma=model.pose_sigma.build(),
        zoom=zoom,
        needs_anchor=model.needs_anchor,
    )
