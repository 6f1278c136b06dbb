"""A rig's YAML file, checked whole: the rig, and for every device its driver's name and section."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from pydantic import BaseModel

from camrig import plugins
from camrig.config import cross_checks
from camrig.config.document import Document, KeyPath, load_document
from camrig.config.models import (
    AnchorModel,
    CameraModel,
    DeviceModel,
    DroneModel,
    FusionModel,
    HeadModel,
    LensModel,
    PlannerModel,
    SpaceModel,
    TargetModel,
)
from camrig.errors import ConfigError, Fault, InputError
from camrig.interfaces import Driver, Plugin, WorldPlugin
from camrig.rig import CameraSpec, Rig

ModelT = TypeVar("ModelT", bound=BaseModel)
PluginT = TypeVar("PluginT")
SectionedT = TypeVar("SectionedT", Plugin[Any], WorldPlugin)
DeviceGroup = Literal["cameras", "heads", "drones"]

_TOP_LEVEL = (
    "rig",
    "space",
    "lenses",
    "cameras",
    "heads",
    "drones",
    "targets",
    "anchors",
    "detector",
    "planner",
    "fusion",
    "outputs",
    "world",
)
_FILLED_BY_WORLD: dict[DeviceGroup, str] = {"cameras": "url", "heads": "port", "drones": "url"}
"""The key of a device's section that an emulated world fills in."""
_UNTIL_FILLED: dict[DeviceGroup, str] = {
    "cameras": "emulated-{}",
    "heads": "emulated-{}",
    "drones": "udpout://{}.emulated:1",
}
"""What stands there while the file is checked."""


@dataclass(frozen=True)
class DeviceConfig:
    """One device: its driver, the driver's section checked, and the section as written."""

    driver_name: str
    driver: Driver[Any, Any]
    section: Any
    raw: Mapping[str, Any]


@dataclass(frozen=True)
class PluginConfig(Generic[PluginT]):
    """A detector, a sink or a world: its plugin and its checked section."""

    name: str
    plugin: PluginT
    section: Any


@dataclass(frozen=True)
class RigConfig:
    """A rig's file, resolved; devices by id."""

    file: str
    rig: Rig
    planner: PlannerModel
    fusion: FusionModel
    devices: Mapping[DeviceGroup, Mapping[str, DeviceConfig]]
    detector: PluginConfig[Plugin[Any]]
    outputs: tuple[PluginConfig[Plugin[Any]], ...]
    world: PluginConfig[WorldPlugin] | None

    def with_ports(self, ports: Mapping[str, str]) -> RigConfig:
        """Return the configuration with the ports and urls that a started world gave its devices."""
        devices: dict[DeviceGroup, Mapping[str, DeviceConfig]] = {}
        for group, key in _FILLED_BY_WORLD.items():
            devices[group] = {
                name: _with_key(device, key, ports[name]) if name in ports else device
                for name, device in self.devices[group].items()
            }
        return replace(self, devices=devices)


def load_rig(path: Path) -> RigConfig:
    """Read and check a rig's YAML; raises ConfigError with all its faults at once."""
    return _Reader(load_document(path)).read()


def _with_key(device: DeviceConfig, key: str, value: str) -> DeviceConfig:
    raw = {**device.raw, key: value}
    own = {name: given for name, given in raw.items() if name != "driver"}
    return replace(device, raw=raw, section=device.driver.section.model_validate(own))


@dataclass
class _Reader:
    """Reads one document section by section, so that a fault in one does not hide those of the others."""

    document: Document
    faults: list[Fault] = field(default_factory=list)

    def read(self) -> RigConfig:
        data = self.document.data
        self._top_level(data)
        name = data.get("rig", "")
        if not isinstance(name, str) or not re.fullmatch(r"\w[\w. -]{0,63}", name):
            self._fault(("rig",), "must name the rig: letters, digits, '_', '.', '-' and spaces, at most 64")
        space = self._model(SpaceModel, ("space",))
        lenses = self._mapping(LensModel, "lenses")
        cameras = self._items(CameraModel, "cameras")
        heads, drones = self._items(HeadModel, "heads"), self._items(DroneModel, "drones")
        targets, anchors = self._items(TargetModel, "targets"), self._items(AnchorModel, "anchors")
        planner = self._model(PlannerModel, ("planner",), default=PlannerModel())
        fusion = self._model(FusionModel, ("fusion",), default=FusionModel())
        world = self._world()
        sources = {at: camera.source for at, camera in cameras.items()}
        devices: dict[DeviceGroup, dict[KeyPath, DeviceConfig]] = {
            "cameras": self._devices("cameras", {(*at, "source"): source for at, source in sources.items()}),
            "heads": self._devices("heads", heads),
            "drones": self._devices("drones", drones),
        }
        specs: dict[DeviceGroup, dict[KeyPath, Any]] = {
            "cameras": {at: _camera_spec(c, lenses[c.lens]) for at, c in cameras.items() if c.lens in lenses},
            "heads": {at: head.build() for at, head in heads.items()},
            "drones": {at: drone.build() for at, drone in drones.items()},
        }
        detector = self._plugin("detectors", ("detector",), {"driver": "pyapriltags"})
        outputs = self._outputs()
        families = tuple(getattr(detector.section, "families", ())) if detector else ()
        parts = cross_checks.Parts(data, cameras, targets, anchors, families or None)
        self.faults += cross_checks.check(self.document, parts)
        self._check_together(specs, devices)
        if self.faults or space is None or planner is None or fusion is None or detector is None:
            raise ConfigError(sorted(set(self.faults)))
        rig = Rig(
            name=name,
            space=space.build(),
            cameras={spec.id: spec for spec in specs["cameras"].values()},
            heads={spec.id: spec for spec in specs["heads"].values()},
            drones={spec.id: spec for spec in specs["drones"].values()},
            targets={target.id: target.build() for target in targets.values()},
            anchors=tuple(anchor.build() for anchor in anchors.values()),
        )
        by_id: dict[DeviceGroup, Mapping[str, DeviceConfig]] = {
            group: {self._id_at(at): device for at, device in found.items()} for group, found in devices.items()
        }
        return RigConfig(self.document.file, rig, planner, fusion, by_id, detector, outputs, world)

    def _check_together(
        self,
        specs: Mapping[DeviceGroup, Mapping[KeyPath, Any]],
        devices: Mapping[DeviceGroup, Mapping[KeyPath, DeviceConfig]],
    ) -> None:
        """Ask every driver for the faults that only all its sections together show (two heads, one address)."""
        for group, found in devices.items():
            # A camera's section stands one level below its spec, under "source".
            sound = {at: specs[group][at[:2]] for at in found if at[:2] in specs[group]}
            at_of = {spec.id: at for at, spec in sound.items()}
            for driver, names in _by_driver({name: found[at] for name, at in at_of.items()}):
                if driver.check is None:
                    continue
                sections = {name: (sound[at_of[name]], found[at_of[name]].section) for name in names}
                for name, key, message in driver.check(sections):
                    self._fault((*at_of[name], key), message)

    def _top_level(self, data: Mapping[str, Any]) -> None:
        for key in data:
            if key not in _TOP_LEVEL:
                self._fault((key,), f"unknown key (allowed: {', '.join(_TOP_LEVEL)})")
        for key in ("rig", "space", "lenses", "cameras"):
            if key not in data:
                self._fault((key,), "is missing")

    def _fault(self, at: KeyPath, message: str) -> None:
        self.faults.append(self.document.fault(at, message))

    def _id_at(self, at: KeyPath) -> str:
        return str(self._node(at[:2])["id"])

    def _node(self, at: KeyPath) -> Any:
        node: Any = self.document.data
        for key in at:
            node = node[key]
        return node

    def _model(self, model: type[ModelT], at: KeyPath, default: ModelT | None = None) -> ModelT | None:
        if at[0] not in self.document.data:
            return default
        found, faults = self.document.validate(model, self._node(at), at)
        self.faults += faults
        return found

    def _mapping(self, model: type[ModelT], key: str) -> dict[str, ModelT]:
        section = self.document.data.get(key, {})
        if not isinstance(section, dict):
            self._fault((key,), "must be a mapping of names")
            return {}
        found = {str(name): self._model(model, (key, name)) for name in section}
        return {name: item for name, item in found.items() if item is not None}

    def _items(self, model: type[ModelT], key: str) -> dict[KeyPath, ModelT]:
        section = self.document.data.get(key) or []
        if not isinstance(section, list):
            self._fault((key,), "must be a list")
            return {}
        found = {(key, index): self._model(model, (key, index)) for index in range(len(section))}
        return {at: item for at, item in found.items() if item is not None}

    def _devices(self, group: DeviceGroup, models: Mapping[KeyPath, DeviceModel]) -> dict[KeyPath, DeviceConfig]:
        devices = {}
        for at, model in models.items():
            raw = model.driver_keys()
            driver = self._found(at, partial(plugins.load_driver, group, model.driver))
            if driver is None:
                continue
            key = _FILLED_BY_WORLD[group]
            emulated = "world" in self.document.data and key in driver.section.model_fields and not raw.get(key)
            written = {**raw, key: _UNTIL_FILLED[group].format(self._id_at(at))} if emulated else raw
            section, faults = self.document.validate(driver.section, written, at)
            self.faults += faults
            if section is not None:
                devices[at] = DeviceConfig(model.driver, driver, section, {"driver": model.driver, **raw})
        return devices

    def _plugin(
        self, group: Literal["detectors", "sinks"], at: KeyPath, default: dict[str, Any] | None = None
    ) -> PluginConfig[Plugin[Any]] | None:
        data = self._node(at) if at[0] in self.document.data else default
        model, faults = self.document.validate(DeviceModel, data, at)
        self.faults += faults
        if model is None:
            return None
        plugin = self._found(at, partial(plugins.load_plugin, group, model.driver))
        return self._with_section(model, plugin, at)

    def _world(self) -> PluginConfig[WorldPlugin] | None:
        model = self._model(DeviceModel, ("world",))
        if model is None:
            return None
        plugin = self._found(("world",), partial(plugins.load_world, model.driver))
        return self._with_section(model, plugin, ("world",))

    def _with_section(
        self, model: DeviceModel, plugin: SectionedT | None, at: KeyPath
    ) -> PluginConfig[SectionedT] | None:
        if plugin is None:
            return None
        section, faults = self.document.validate(plugin.section, model.driver_keys(), at)
        self.faults += faults
        return None if section is None else PluginConfig(model.driver, plugin, section)

    def _outputs(self) -> tuple[PluginConfig[Plugin[Any]], ...]:
        section = self.document.data.get("outputs") or []
        if not isinstance(section, list):
            self._fault(("outputs",), "must be a list")
            return ()
        found = [self._plugin("sinks", ("outputs", index)) for index in range(len(section))]
        return tuple(output for output in found if output is not None)

    def _found(self, at: KeyPath, load: Callable[[], PluginT]) -> PluginT | None:
        try:
            return load()
        except InputError as error:
            self._fault((*at, "driver"), str(error))
            return None


def _camera_spec(camera: CameraModel, lens: LensModel) -> CameraSpec:
    return CameraSpec(camera.id, lens.build(), camera.mount.build(), lens.readout_s)


def _by_driver(devices: Mapping[str, DeviceConfig]) -> Iterable[tuple[Driver[Any, Any], list[str]]]:
    """Group device ids by the driver they share."""
    groups: dict[str, tuple[Driver[Any, Any], list[str]]] = {}
    for name, device in devices.items():
        groups.setdefault(device.driver_name, (device.driver, []))[1].append(name)
    return groups.values()
