"""From a rig and its YAML to the settings of its emulated devices. Pure; raises InputError for what cannot be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from camrig.errors import InputError
from camrig.geometry.arrays import Array
from camrig.rig import DroneMount, FreeMount, HeadMount, HeadSpec, Rig
from camrig_emulators.mavlink.settings import MavlinkDroneSettings
from camrig_emulators.pelco_d_settings import PelcoDHeadSettings
from camrig_emulators.world_section import WorldHeadSection, WorldSection

SettingsT = TypeVar("SettingsT", bound=BaseModel)
Devices = Mapping[str, Mapping[str, Any]]
"""The YAML of each camera source, head and drone by id, as written."""

_START_TILT_RAD = math.radians(-45.0)
_LIMIT_SPARE_DEG = 1.0
"""How far a head can turn past the limits that the rig gives it."""
_USUAL_BACKLASH_DEG = 0.05
_USUAL_ZERO_ERROR_DEG = 0.05
_DRONE_SPACING_M = 1.0
_FORWARD_OPTICAL = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
"""From the optical frame to one that looks along x, z up (docs/frames-and-units.md)."""
_POSES = ("T_arm_tilt", "T_mount_camera")
_AXIS_KEYS = ("sign", "scale", "offset_deg")


def head_lines(rig: Rig, section: WorldSection, devices: Devices) -> list[list[PelcoDHeadSettings]]:
    """Return the heads of each serial line; heads whose YAML names the same ``port`` share one."""
    _only_known("heads", section.heads, rig.heads)
    lines: dict[str, list[PelcoDHeadSettings]] = {}
    for number, name in enumerate(rig.heads):
        raw = devices.get(name, {})
        if raw.get("driver") != "pelco_d":
            continue
        errors = np.random.default_rng([section.seed, 1, number]).normal(0.0, _USUAL_ZERO_ERROR_DEG, 2)
        settings = _head_settings(rig, rig.heads[name], raw, section.heads.get(name, WorldHeadSection()), errors)
        lines.setdefault(str(raw.get("port") or f"line of {name}"), []).append(settings)
    return list(lines.values())


_FAILSAFES = {
    "ardupilot": {"FS_GCS_ENABLE": 5.0, "GUID_TIMEOUT": 1.0},
    "px4": {"COM_OBL_RC_ACT": 4.0, "NAV_DLL_ACT": 3.0},
}
"""An emulated rig's drones are set up as a driver wants them to be before it lets them fly."""


def drones(rig: Rig, section: WorldSection, devices: Devices) -> list[MavlinkDroneSettings]:
    """Return the settings of every drone with ``driver: mavlink``."""
    _only_known("drones", section.drones, rig.drones)
    names = [name for name in rig.drones if devices.get(name, {}).get("driver") == "mavlink"]
    low, high = np.asarray(rig.space.floor_m)
    found = []
    for number, name in enumerate(names):
        raw = devices[name]
        middle = (low + high) / 2.0 + [(number - (len(names) - 1) / 2.0) * _DRONE_SPACING_M, 0.0]
        x, y = (float(value) for value in np.clip(middle, low, high))
        keys = {key: raw[key] for key in ("system", "origin_m") if key in raw}
        override = section.drones.get(name)
        given = {} if override is None else override.model_dump(exclude_none=True)
        usual = {"start_position_m": (x, y, 0.0), "params": _FAILSAFES[given.get("flavour", "ardupilot")]}
        found.append(_build(MavlinkDroneSettings, name, {**usual, **keys, **given}))
    return found


def rendered_cameras(rig: Rig, devices: Devices) -> dict[str, float]:
    """Return the frames per second of every camera with ``driver: rendered``, by id."""
    found = {}
    for name, camera in rig.cameras.items():
        raw = devices.get(name, {})
        if raw.get("driver") != "rendered":
            continue
        match camera.mount:
            case FreeMount():
                raise InputError(f"camera {name}: a rendered camera needs a mount that says where it is, not free")
            case HeadMount(head=carrier) if devices.get(carrier, {}).get("driver") != "pelco_d":
                raise InputError(f"camera {name}: its head {carrier} is not emulated; give it driver: pelco_d")
            case DroneMount(drone=carrier) if devices.get(carrier, {}).get("driver") != "mavlink":
                raise InputError(f"camera {name}: its drone {carrier} is not emulated; give it driver: mavlink")
        found[name] = float(raw.get("fps", 10.0))
    return found


def true_rig(rig: Rig, section: WorldSection) -> Rig:
    """Return the rig as it truly is, where the world says other poses than the file."""
    heads, cameras = dict(rig.heads), dict(rig.cameras)
    for name, override in section.heads.items():
        if override.T_arm_tilt is not None:
            kinematics = replace(heads[name].kinematics, T_arm_tilt=override.T_arm_tilt.matrix())
            heads[name] = replace(heads[name], kinematics=kinematics)
        carried = rig.camera_on(name)
        if override.T_mount_camera is not None and carried is not None:
            T_forward_optical = np.eye(4)
            T_forward_optical[:3, :3] = _FORWARD_OPTICAL
            mount = HeadMount(name, override.T_mount_camera.matrix() @ T_forward_optical)
            cameras[carried.id] = replace(carried, mount=mount)
    return replace(rig, heads=heads, cameras=cameras)


def _head_settings(
    rig: Rig, spec: HeadSpec, raw: Mapping[str, Any], override: WorldHeadSection, zero_error_deg: Array
) -> PelcoDHeadSettings:
    pan_rad, tilt_rad = _start_aim(rig, spec)
    axes = {
        axis: {key: scale[key] for key in _AXIS_KEYS if key in scale} for axis, scale in raw.get("axes", {}).items()
    }
    return _build(
        PelcoDHeadSettings,
        spec.id,
        {
            **{key: raw[key] for key in ("address", "baud") if key in raw},
            "axes": axes,
            "start_pan_deg": math.degrees(pan_rad),
            "start_tilt_deg": math.degrees(tilt_rad),
            "pan_limits_deg": _mechanical_limits(spec.pan_limits_rad),
            "tilt_limits_deg": _mechanical_limits(spec.tilt_limits_rad),
            "max_speed_deg_s": math.degrees(spec.speed_rad_s),
            "backlash_deg": _USUAL_BACKLASH_DEG,
            "zero_error_deg": tuple(float(error) for error in zero_error_deg),
            **override.model_dump(exclude_none=True, exclude=set(_POSES)),
        },
    )


def _start_aim(rig: Rig, spec: HeadSpec) -> tuple[float, float]:
    """Return pan and tilt that look 45 deg down towards the middle of the floor, as far as the limits let them."""
    base = spec.kinematics.T_world_base
    dx, dy = np.mean(rig.space.floor_m, axis=0) - base[:2, 3]
    bearing_rad = math.atan2(dy, dx)
    level = math.cos(_START_TILT_RAD)
    direction = np.array([level * math.cos(bearing_rad), level * math.sin(bearing_rad), math.sin(_START_TILT_RAD)])
    x, y, z = base[:3, :3].T @ direction
    return (
        float(np.clip(math.atan2(y, x), *spec.pan_limits_rad)),
        float(np.clip(math.atan2(z, math.hypot(x, y)), *spec.tilt_limits_rad)),
    )


def _mechanical_limits(limits_rad: tuple[float, float]) -> tuple[float, float] | None:
    """Return a little more than the rig's limits in degrees; None for a head that turns without end."""
    low, high = (math.degrees(limit) for limit in limits_rad)
    return None if high - low >= 360.0 - 2.0 * _LIMIT_SPARE_DEG else (low - _LIMIT_SPARE_DEG, high + _LIMIT_SPARE_DEG)


def _build(model: type[SettingsT], name: str, keys: Mapping[str, Any]) -> SettingsT:
    try:
        return model.model_validate({"id": name, **keys})
    except ValidationError as error:
        first = error.errors()[0]
        at = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"emulated {name}: {at}: {first['msg']}" if at else f"emulated {name}: {first['msg']}"
        ) from error


def _only_known(key: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    strangers = sorted(set(given) - set(known))
    if strangers:
        raise InputError(
            f"world.{key}: {', '.join(strangers)} is none of the rig's {key} ({', '.join(known) or 'it has none'})"
        )
