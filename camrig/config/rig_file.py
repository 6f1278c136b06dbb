"""A rig's YAML file, checked whole: the rig, and for every device its driver's name and section."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from camrig import plugins
from camrig.config import cross_checks
from camrig.config.document import Document, KeyPath, load_document
from camrig.config.lenses import LensModel
from camrig.config.models import (
    AnchorModel,
    CameraModel,
    DetectorModel,
    DeviceModel,
    DroneModel,
    FusionModel,
    HeadModel,
    PlannerModel,
    SpaceModel,
    TargetModel,
)
from camrig.config.sections import Sections
from camrig.errors import ConfigError, InputError
from camrig.interfaces import Driver, Plugin, WorldPlugin
from camrig.rig import CameraSpec, Rig

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

    def amended(self, changes: Mapping[tuple[str, ...], object]) -> DeviceConfig:
        """Return it with values of its section set, by path within its keys."""
        keys: dict[str, Any] = deepcopy(dict(self.raw))
        for path, value in changes.items():
            at = keys
            for key in path[:-1]:
                at = at.setdefault(key, {})
            at[path[-1]] = value
        own = {name: given for name, given in keys.items() if name != "driver"}
        return replace(self, raw=keys, section=self.driver.section.model_validate(own))


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
    refine: bool
    outputs: tuple[PluginConfig[Plugin[Any]], ...]
    world: PluginConfig[WorldPlugin] | None
    text: str
    """What was read."""

    def with_ports(self, ports: Mapping[str, str]) -> RigConfig:
        """Return the configuration with the ports and urls that a started world gave its devices."""
        devices: dict[DeviceGroup, Mapping[str, DeviceConfig]] = {}
        for group, key in _FILLED_BY_WORLD.items():
            devices[group] = {
                name: device.amended({(key,): ports[name]}) if name in ports else device
                for name, device in self.devices[group].items()
            }
        return replace(self, devices=devices)


def load_rig(path: Path) -> RigConfig:
    """Read and check a rig's YAML; raises ConfigError with all its faults at once."""
    return read_rig(load_document(path))


def read_rig(document: Document) -> RigConfig:
    """Check a rig's document; raises ConfigError with all its faults at once."""
    return _Reader(Sections(document)).read()


def _camera(camera: CameraModel, lens: LensModel) -> CameraSpec:
    mount, sigma = camera.mount.build(), camera.lens_sigma.build()
    when = camera.calibrated
    return CameraSpec(camera.id, lens.build(), mount, lens.readout_s, camera.refine_lens, sigma, when)


@dataclass
class _Reader:
    """Reads the sections of one document, the drivers' among them."""

    file: Sections

    def read(self) -> RigConfig:
        file, data = self.file, self.file.document.data
        self._top_level(data)
        name = data.get("rig", "")
        if not isinstance(name, str) or not re.fullmatch(r"\w[\w. -]{0,63}", name):
            file.fault(("rig",), "must name the rig: letters, digits, '_', '.', '-' and spaces, at most 64")
        space = file.model(SpaceModel, ("space",))
        lenses = file.lenses() if "lenses" in data else {}
        cameras = file.items(CameraModel, "cameras")
        heads, drones = file.items(HeadModel, "heads"), file.items(DroneModel, "drones")
        targets, anchors = file.items(TargetModel, "targets"), file.items(AnchorModel, "anchors")
        planner = file.model(PlannerModel, ("planner",), default=PlannerModel())
        fusion = file.model(FusionModel, ("fusion",), default=FusionModel())
        world = self._world()
        sources = {at: camera.source for at, camera in cameras.items()}
        devices: dict[DeviceGroup, dict[KeyPath, DeviceConfig]] = {
            "cameras": self._devices("cameras", {(*at, "source"): source for at, source in sources.items()}),
            "heads": self._devices("heads", heads),
            "drones": self._devices("drones", drones),
        }
        specs: dict[DeviceGroup, dict[KeyPath, Any]] = {
            "cameras": {
                at: _camera(camera, lens)
                for at, camera in cameras.items()
                if isinstance(lens := lenses.get(camera.lens), LensModel)
            },
            "heads": {at: head.build() for at, head in heads.items()},
            "drones": {at: drone.build() for at, drone in drones.items()},
        }
        how = file.model(DetectorModel, ("detector",), default=DetectorModel())
        detector = None if how is None else self._plugin("detectors", ("detector",), how)
        outputs = self._outputs()
        families = tuple(getattr(detector.section, "families", ())) if detector else ()
        parts = cross_checks.Parts(data, lenses, cameras, {**heads, **drones}, targets, anchors, families or None)
        file.faults += cross_checks.check(file.document, parts)
        self._check_together(specs, devices)
        if file.faults or space is None or planner is None or fusion is None or how is None or detector is None:
            raise ConfigError(sorted(set(file.faults)))
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
        text, refine = file.document.text, how.refine
        return RigConfig(file.document.file, rig, planner, fusion, by_id, detector, refine, outputs, world, text)

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
                    self.file.fault((*at_of[name], key), message)

    def _top_level(self, data: Mapping[str, Any]) -> None:
        for key in data:
            if key not in _TOP_LEVEL:
                self.file.fault((key,), f"unknown key (allowed: {', '.join(_TOP_LEVEL)})")
        for key in ("rig", "space", "lenses", "cameras"):
            if key not in data:
                self.file.fault((key,), "is missing")

    def _id_at(self, at: KeyPath) -> str:
        return str(self.file.node(at[:2])["id"])

    def _devices(self, group: DeviceGroup, models: Mapping[KeyPath, DeviceModel]) -> dict[KeyPath, DeviceConfig]:
        devices = {}
        for at, model in models.items():
            raw = model.driver_keys()
            driver = self._found(at, partial(plugins.load_driver, group, model.driver))
            if driver is None:
                continue
            key = _FILLED_BY_WORLD[group]
            emulated = "world" in self.file.document.data and key in driver.section.model_fields and not raw.get(key)
            written = {**raw, key: _UNTIL_FILLED[group].format(self._id_at(at))} if emulated else raw
            section = self.file.checked(driver.section, written, at)
            if section is not None:
                devices[at] = DeviceConfig(model.driver, driver, section, {"driver": model.driver, **raw})
        return devices

    def _plugin(
        self, group: Literal["detectors", "sinks"], at: KeyPath, model: DeviceModel
    ) -> PluginConfig[Plugin[Any]] | None:
        plugin = self._found(at, partial(plugins.load_plugin, group, model.driver))
        return self._with_section(model, plugin, at)

    def _world(self) -> PluginConfig[WorldPlugin] | None:
        model = self.file.model(DeviceModel, ("world",))
        if model is None:
            return None
        plugin = self._found(("world",), partial(plugins.load_world, model.driver))
        return self._with_section(model, plugin, ("world",))

    def _with_section(
        self, model: DeviceModel, plugin: SectionedT | None, at: KeyPath
    ) -> PluginConfig[SectionedT] | None:
        if plugin is None:
            return None
        section = self.file.checked(plugin.section, model.driver_keys(), at)
        return None if section is None else PluginConfig(model.driver, plugin, section)

    def _outputs(self) -> tuple[PluginConfig[Plugin[Any]], ...]:
        models = {at: self.file.checked(DeviceModel, self.file.node(at), at) for at in self.file.places("outputs")}
        found = [self._plugin("sinks", at, model) for at, model in models.items() if model is not None]
        return tuple(output for output in found if output is not None)

    def _found(self, at: KeyPath, load: Callable[[], PluginT]) -> PluginT | None:
        try:
            return load()
        except InputError as error:
            self.file.fault((*at, "driver"), str(error))
            return None


def _by_driver(devices: Mapping[str, DeviceConfig]) -> Iterable[tuple[Driver[Any, Any], list[str]]]:
    """Group device ids by the driver they share."""
    groups: dict[str, tuple[Driver[Any, Any], list[str]]] = {}
    for name, device in devices.items():
        groups.setdefault(device.driver_name, (device.driver, []))[1].append(name)
    return groups.values()
