"""Rules between the sections of a rig's file: every fault with its line and key.

Names are looked up in the file as written, so that a fault inside one section does not raise a false one elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from camrig.config.document import Document, KeyPath
from camrig.config.lenses import AnyLensModel, ZoomLensModel
from camrig.config.models import AnchorModel, BodyTagModel, CameraModel, DroneModel, HeadModel, TargetModel
from camrig.config.sections import repeated_ids, written_ids
from camrig.errors import Fault
from camrig.rig import TagKey

Finding = tuple[KeyPath, str]


@dataclass(frozen=True)
class Parts:
    """The file as written, and its sections that are well formed by themselves, by their place in it."""

    data: Mapping[str, Any]
    lenses: Mapping[str, AnyLensModel]
    cameras: Mapping[KeyPath, CameraModel]
    carriers: Mapping[KeyPath, HeadModel | DroneModel]
    targets: Mapping[KeyPath, TargetModel]
    anchors: Mapping[KeyPath, AnchorModel]
    families: tuple[str, ...] | None
    """The detector's families, where it names them."""


def check(document: Document, parts: Parts) -> list[Fault]:
    """Return the faults that only several sections together show."""
    found: list[Finding] = []
    for rule in (
        _unique_ids,
        _references,
        _one_camera_each,
        _tags_once,
        _families,
        _needs_anchor,
        _no_zoom,
        _refined_jointly,
    ):
        found += rule(parts)
    return [document.fault(at, message) for at, message in found]


def _unique_ids(parts: Parts) -> Iterator[Finding]:
    """Devices share one name space: an id in a log or a command means one thing."""
    yield from repeated_ids(parts.data, "cameras", "heads", "drones")
    yield from repeated_ids(parts.data, "targets")


def _references(parts: Parts) -> Iterator[Finding]:
    lenses = parts.data.get("lenses")
    known = {
        "lens": tuple(lenses) if isinstance(lenses, dict) else (),
        "head": tuple(name for _, name in written_ids(parts.data, "heads")),
        "drone": tuple(name for _, name in written_ids(parts.data, "drones")),
    }
    for at, camera in parts.cameras.items():
        wanted = {"lens": camera.lens, "head": camera.mount.head, "drone": camera.mount.drone}
        for kind, name in wanted.items():
            if name is not None and name not in known[kind]:
                place = at if kind == "lens" else (*at, "mount")
                listed = ", ".join(known[kind]) or "none"
                yield (*place, kind), f"there is no {kind} '{name}'; this file defines: {listed}"


def _one_camera_each(parts: Parts) -> Iterator[Finding]:
    carried: dict[str, str] = {}
    for at, camera in parts.cameras.items():
        carrier = camera.mount.head or camera.mount.drone
        if carrier is None:
            continue
        first = carried.setdefault(carrier, camera.id)
        if first != camera.id:
            yield (*at, "mount"), f"'{carrier}' already carries camera '{first}'; it can carry one"
    carriers = {name: at for at, name in written_ids(parts.data, "heads", "drones")}
    written = parts.data.get("cameras")
    if not isinstance(written, list) or len(parts.cameras) < len(written) or not carried.keys() <= carriers.keys():
        return  # a camera that is not understood may be the missing one
    for name, at in carriers.items():
        if name not in carried:
            yield at, f"'{name}' carries no camera; mount one on it or remove it"


def _written_tags(parts: Parts) -> Iterator[tuple[KeyPath, BodyTagModel | AnchorModel]]:
    for at, target in parts.targets.items():
        for index, tag in enumerate(target.tags):
            yield (*at, "tags", index), tag
    yield from parts.anchors.items()


def _tags_once(parts: Parts) -> Iterator[Finding]:
    first: dict[TagKey, KeyPath] = {}
    for at, tag in _written_tags(parts):
        key = TagKey(tag.family, tag.id)
        earlier = first.setdefault(key, at)
        if earlier != at:
            yield (*at, "id"), f"tag {key} is already listed at {earlier[0]}[{earlier[1]}]; a tag appears once"


def _families(parts: Parts) -> Iterator[Finding]:
    if parts.families is None:
        return
    for at, tag in _written_tags(parts):
        if tag.family not in parts.families:
            yield (
                (*at, "family"),
                f"the detector does not look for {tag.family}; its families: {', '.join(parts.families)}",
            )


def _needs_anchor(parts: Parts) -> Iterator[Finding]:
    if parts.data.get("anchors"):
        return
    for at, camera in parts.cameras.items():
        if camera.mount.free:
            yield (*at, "mount", "free"), "a camera of unknown pose needs at least one anchor in this file"
    for at, carrier in parts.carriers.items():
        if carrier.needs_anchor:
            yield (*at, "needs_anchor"), f"'{carrier.id}' must keep an anchor in view, and this file lists no anchors"


def _no_zoom(parts: Parts) -> Iterator[Finding]:
    for at, camera in parts.cameras.items():
        if isinstance(parts.lenses.get(camera.lens), ZoomLensModel):
            message = (
                f"'{camera.lens}' is a zoom lens, and a running rig does not drive a zoom yet: "
                "give the lens at the zoom in use, or plan it off line with `camrig plan`"
            )
            yield (*at, "lens"), message


def _refined_jointly(parts: Parts) -> Iterator[Finding]:
    fusion = parts.data.get("fusion")
    estimator = fusion.get("estimator", "joint") if isinstance(fusion, dict) else "joint"
    for at, camera in parts.cameras.items():
        if camera.refine_lens and estimator != "joint":
            yield (*at, "refine_lens"), f"only fusion: {{estimator: joint}} refines lenses; this file has '{estimator}'"
