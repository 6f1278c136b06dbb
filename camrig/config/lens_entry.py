"""A calibrated lens as a rig's file writes it, and the changes that put it there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from camrig.config.document import Document, KeyPath
from camrig.config.models import LensSigmaModel
from camrig.errors import InputError
from camrig.geometry.lens import BrownLens, FisheyeLens

_KEYS = ("model", "size_px", "fx", "fy", "cx", "cy", "distortion", "r_max")
_MOST_F_PERCENT, _MOST_CENTRE_PX, _MOST_K1 = 5.0, 100.0, 0.1
"""What a camera's ``lens_sigma`` may say."""


def lens_entry(lens: BrownLens | FisheyeLens, distortion: tuple[float, ...]) -> dict[str, Any]:
    """Return the keys of a lens, rounded to what no measurement resolves."""
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    return {
        "model": "fisheye" if isinstance(lens, FisheyeLens) else "brown",
        "size_px": list(lens.size_px),
        "fx": round(fx, 4),
        "fy": round(fy, 4),
        "cx": round(cx, 4),
        "cy": round(cy, 4),
        "distortion": [float(f"{value:.8g}") for value in distortion],
        "r_max": math.floor(1e4 * lens.r_max) / 1e4,
    }


def lens_changes(
    document: Document, camera: str, entry: Mapping[str, Any], sigma: Mapping[str, float] | None
) -> dict[KeyPath, object]:
    """Return what to amend in a rig's file: the lens of a camera, and what it may be off by where that is known.

    Without ``sigma`` a camera that has one gets the usual one: its own was of its former lens. A lens of other cameras
    too stays theirs: the camera gets one of its own name. Raises InputError where that name is taken, or where the
    lens has a table of zoom.
    """
    cameras = [each for each in document.data["cameras"] if isinstance(each, dict)]
    mine = next(each for each in cameras if each.get("id") == camera)
    name = str(mine["lens"])
    changes: dict[KeyPath, object] = {}
    former = document.data["lenses"][name]
    if "zoom" in former:
        raise InputError(f"lens '{name}' has a table of zoom: give --zoom-position and --out")
    if any(each.get("lens") == name and each is not mine for each in cameras):
        if camera in document.data["lenses"]:
            raise InputError(
                f"lens '{name}' is other cameras' too, and a lens '{camera}' of {camera}'s own is there already: "
                f"let {camera} have that one, and calibrate again"
            )
        kept = {"readout_s": former["readout_s"]} if "readout_s" in former else {}
        changes["lenses", camera] = {**entry, **kept}
        changes["cameras", camera, "lens"] = camera
    else:
        changes |= {("lenses", name, key): value for key, value in entry.items()}
    if sigma is not None:
        changes["cameras", camera, "lens_sigma"] = _lens_sigma(entry, sigma)
    elif "lens_sigma" in mine:
        changes["cameras", camera, "lens_sigma"] = LensSigmaModel().model_dump()
    return changes


def lens_places(document: Document, camera: str) -> list[KeyPath]:
    """Return where a calibration would write, before it is known what; raises InputError as ``lens_changes`` does."""
    return [*lens_changes(document, camera, dict.fromkeys(_KEYS), None), ("cameras", camera, "lens_sigma")]


def _lens_sigma(entry: Mapping[str, Any], sigma: Mapping[str, float]) -> dict[str, float]:
    return {
        "f_percent": _within(100.0 * sigma["fx"] / entry["fx"], _MOST_F_PERCENT),
        "centre_px": _within(max(sigma["cx"], sigma["cy"]), _MOST_CENTRE_PX),
        "k1": _within(sigma.get("k1", 0.0), _MOST_K1),
    }


def with_zoom_row(lens: Mapping[str, Any], position: float, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return a lens's section with the row of one zoom position put in, or in place of the one that was there.

    Raises InputError where the lens is of another model or size.
    """
    for key in ("model", "size_px"):
        if key in lens and lens[key] != entry[key]:
            raise InputError(
                f"the lens's table has {key} {lens[key]}, this calibration {entry[key]}: they cannot be one"
            )
    row = {"position": position, **{key: entry[key] for key in ("fx", "fy", "cx", "cy", "distortion", "r_max")}}
    rows = [each for each in lens.get("zoom", []) if each.get("position") != position]
    rows = sorted([*rows, row], key=lambda each: float(each["position"]))
    kept = {key: value for key, value in lens.items() if key == "readout_s"}
    return {"model": entry["model"], "size_px": entry["size_px"], **kept, "zoom": rows}


def _within(value: float, most: float) -> float:
    return float(f"{min(max(value, 1e-6), most):.3g}")
