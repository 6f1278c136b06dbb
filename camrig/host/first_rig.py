"""The first YAML of a rig: what is plugged in, and placeholders for what only a tape measure knows. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from camrig.host.plugged_in import Device, PluggedIn

_DEFAULT_SIZE_PX = (1280, 720)
_FOCAL_PER_WIDTH = 0.8
"""A usual webcam's: 64 degrees from side to side."""
_SPACING_M = 1.5


def first_rig(found: PluggedIn, name: str) -> str:
    """Return the text of a rig's file that `camrig check` accepts: cameras on heads while there are ports for them."""
    cameras = [device for device in found.cameras if device.found.size_px is not None]
    heads = found.ports[: max(1, len(cameras))]
    return "\n".join([*_head(name), *_cameras(cameras, len(heads)), *_heads(heads), *_rest(found, cameras)]) + "\n"


def _head(name: str) -> Iterator[str]:
    yield "# A first rig, from what was plugged in. Lengths in metres, angles in degrees; measure what says MEASURE."
    yield "# `camrig check FILE` validates it, `camrig check --open FILE` also opens its cameras. Nothing moves before"
    yield "# `camrig run FILE`, and heads not before `camrig resume`: each has `enable: manual`."
    yield f"rig: {name}"
    yield "space:"
    yield "  floor_m: [[0, 0], [5, 3]]                # MEASURE: the floor on which targets live, from corner to corner"


def _cameras(cameras: list[Device], heads: int) -> Iterator[str]:
    sizes = list(dict.fromkeys(device.found.size_px or _DEFAULT_SIZE_PX for device in cameras)) or [_DEFAULT_SIZE_PX]
    yield "lenses:                                    # CALIBRATE: these are a usual webcam's, good to 10 % at best"
    for width, height in sizes:
        focal = round(_FOCAL_PER_WIDTH * width)
        yield (
            f"  lens_{width}x{height}: {{model: brown, size_px: [{width}, {height}], fx: {focal}, fy: {focal}, "
            f"cx: {width / 2:g}, cy: {height / 2:g}}}"
        )
    yield "cameras:"
    if not cameras:
        yield "  # No camera was plugged in that camrig can use: this one is a placeholder."
    sources = [(device.drivers[0], device.found.title, device.found.section) for device in cameras]
    sources = sources or [("v4l2", "a placeholder", {"device": "/dev/video0", "format": "YUYV"})]
    for index, (driver, title, section) in enumerate(sources):
        width, height = sizes[0] if not cameras else cameras[index].found.size_px or _DEFAULT_SIZE_PX
        yield f"  - id: cam{index + 1}                               # {_comment(title)}"
        yield f"    lens: lens_{width}x{height}"
        yield f"    source: {_flow({'driver': driver, **section})}"
        if index < heads:
            yield f"    mount: {{head: pt{index + 1}}}"
        else:
            x = 0.5 + _SPACING_M * index
            yield f"    mount: {{fixed: {{position_m: [{x:g}, 1.5, 2.8], pan_deg: 0, tilt_deg: -90}}}}   # MEASURE"
    yield "    # Focus must not change once the lens is calibrated, nor exposure while tags move. Add to `source:`:"
    yield "    #   lock: [exposure, focus, gain, white_balance]"
    yield "    #   exposure: {max_blur_px: 1.0, speed_deg_s: 30}   # or let camrig rule exposure and gain"


def _heads(heads: tuple[Device, ...]) -> Iterator[str]:
    if not heads:
        yield "# No serial port was found: every camera stands still. A pan-tilt head would be:"
        yield "# heads:"
        yield "#   - {id: pt1, driver: pelco_d, port: /dev/ttyUSB0, address: 1, position_m: [1, 1.5, 2.8]}"
        return
    yield "heads:"
    for index, device in enumerate(heads):
        others = f"; or driver {', '.join(device.drivers[1:])}" if device.drivers[1:] else ""
        yield f"  - id: pt{index + 1}                                # {_comment(device.found.title)}{others}"
        yield f"    driver: {device.drivers[0]}"
        for key, value in device.found.section.items():
            yield f"    {key}: {json.dumps(value)}"
        yield "    enable: manual                         # moves only after `camrig resume`; auto: from the start"
        yield f"    position_m: [{0.5 + _SPACING_M * index:g}, 1.5, 2.8]             # MEASURE: where both axes meet"
        yield "    rpy_deg: [0, 0, 0]                     # MEASURE: pan 0 looks along the base's x"
        yield "    pan_deg: [-170, 170]                   # the limits of its manual, less what its cables need"
        yield "    tilt_deg: [-90, 0]"


def _rest(found: PluggedIn, cameras: list[Device]) -> Iterator[str]:
    yield "targets:                                   # what is to be located: list every tag, MEASURE its black square"
    yield "  - {id: robot1, motion: floor, tags: [{family: tag36h11, id: 1, size_m: 0.12}]}"
    yield "# anchors:                                 # tags fixed in the room correct where cameras are"
    yield "#   - {family: tag36h11, id: 100, size_m: 0.2, T_world_tag: {position_m: [1, 1, 0]}}"
    yield 'outputs: [{driver: jsonl, path: "-"}]      # targets as lines of JSON on standard output'
    left = [device.found for device in found.cameras if device not in cameras]
    if left:
        yield "# Plugged in and left out:"
        yield from (f"#   {_comment(device.name)}: {_comment(device.trouble)}" for device in left)


def _flow(section: Mapping[str, object]) -> str:
    """Write a mapping on one line; JSON's scalars are YAML's."""
    return "{" + ", ".join(f"{key}: {json.dumps(value)}" for key, value in section.items()) + "}"


def _comment(text: str) -> str:
    """Return text that cannot end the comment it stands in."""
    return " ".join(text.split())
