"""``camrig check``: validates a rig's file and prints the resolved rig."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from camrig.cli.console import print_json, results
from camrig.cli.run import log_to_stderr
from camrig.cli.try_cameras import try_cameras
from camrig.config.rig_file import RigConfig, load_rig
from camrig.rig import DroneMount, FixedMount, HeadMount, Mount


def check(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file.")],
    open_cameras: Annotated[
        bool, typer.Option("--open", help="Also open every camera, set it as the file says, and take a picture.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Validate a rig's file: all its faults at once, or the resolved rig. Moves nothing, opens cameras only if told."""
    rig_config = load_rig(config)
    if open_cameras:
        log_to_stderr()
        try_cameras(rig_config)
    if as_json:
        print_json(_as_json(rig_config))
        return
    for table in (_cameras(rig_config), _carriers(rig_config), _bodies(rig_config)):
        if table.row_count:
            results.print(table)
    results.print(f"{config}: rig '{rig_config.rig.name}' is consistent.", style="green", soft_wrap=True, markup=False)


def _mounted_on(mount: Mount) -> str:
    match mount:
        case HeadMount(head=name):
            return f"head {name}"
        case DroneMount(drone=name):
            return f"drone {name}"
        case FixedMount():
            return "fixed"
    return "free (pose from anchors)"


def _cameras(config: RigConfig) -> Table:
    table = Table("camera", "on", "source", "size", "fx, fy", "r_max", title="Cameras")
    for name, camera in config.rig.cameras.items():
        lens = camera.lens
        size, focal = f"{lens.size_px[0]} x {lens.size_px[1]}", f"{lens.focal_px[0]:.1f}, {lens.focal_px[1]:.1f}"
        source = config.devices["cameras"][name].driver_name
        table.add_row(name, _mounted_on(camera.mount), source, size, focal, f"{lens.r_max:.3f}")
    return table


def _carriers(config: RigConfig) -> Table:
    table = Table("id", "driver", "at or within", "limits", "speed", "enabled by", title="Heads and drones")
    for name, head in config.rig.heads.items():
        at = ", ".join(f"{value:.2f}" for value in head.kinematics.T_world_base[:3, 3])
        pan, tilt = (
            "{:.0f}..{:.0f}".format(*map(math.degrees, limits))
            for limits in (head.pan_limits_rad, head.tilt_limits_rad)
        )
        driver = config.devices["heads"][name].driver_name
        speed = f"{math.degrees(head.speed_rad_s):.0f} deg/s"
        enabled = "start-up" if head.auto_enable else "operator"
        table.add_row(name, driver, f"{at} m", f"pan {pan}, tilt {tilt} deg", speed, enabled)
    for name, drone in config.rig.drones.items():
        low, high = (", ".join(f"{value:g}" for value in corner) for corner in drone.box_m)
        driver = config.devices["drones"][name].driver_name
        apart = f"{drone.min_separation_m:g} m apart"
        table.add_row(name, driver, f"{low} to {high} m", apart, f"{drone.speed_m_s:g} m/s", "operator's arm")
    return table


def _bodies(config: RigConfig) -> Table:
    table = Table("what", "tags", "motion", "weight", title="Targets and anchors")
    for name, body in config.rig.targets.items():
        tags = ", ".join(f"{tag.key} ({tag.size_m * 1000:.0f} mm)" for tag in body.tags)
        table.add_row(name, tags, body.motion, f"{body.weight:g}")
    for anchor in config.rig.anchors:
        table.add_row("anchor", f"{anchor.key} ({anchor.size_m * 1000:.0f} mm)", "fixed", "")
    return table


def _as_json(config: RigConfig) -> dict[str, object]:
    rig = config.rig
    return {
        "rig": rig.name,
        "cameras": {
            name: {
                "on": _mounted_on(camera.mount),
                "source": config.devices["cameras"][name].driver_name,
                "size_px": list(camera.lens.size_px),
                "r_max": camera.lens.r_max,
            }
            for name, camera in rig.cameras.items()
        },
        "heads": {name: config.devices["heads"][name].driver_name for name in rig.heads},
        "drones": {name: config.devices["drones"][name].driver_name for name in rig.drones},
        "targets": {name: [str(tag.key) for tag in body.tags] for name, body in rig.targets.items()},
        "anchors": [str(anchor.key) for anchor in rig.anchors],
        "emulated": config.world is not None,
    }
