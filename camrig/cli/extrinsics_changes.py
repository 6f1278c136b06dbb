"""What ``camrig calibrate extrinsics --write`` changes in a rig's file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, date, datetime

from camrig.cli.console import people
from camrig.cli.extrinsics_answer import Answer, rpy_deg, without_optical
from camrig.config.document import KeyPath
from camrig.errors import InputError
from camrig.geometry.arrays import Transform
from camrig.geometry.pan_tilt import look_of
from camrig.rig import HeadMount, Rig, TagKey


def changes(answer: Answer, today: date, *, anchors: bool) -> dict[KeyPath, object]:
    """Return the values to set by where they are.

    Raises InputError where nothing says where the world is.
    """
    if not answer.in_world:
        raise InputError("nothing says where the world is, so nothing is written: see an anchor, --origin or --keep")
    found: dict[KeyPath, object] = {}
    for name, pose in answer.found.cameras.items():
        if name not in answer.placeless:
            found["cameras", name, "mount", "fixed"] = _fixed(pose.T)
            found["cameras", name, "calibrated"] = today
    for name, base in answer.found.bases.items():
        mount = answer.rig.cameras[name].mount
        assert isinstance(mount, HeadMount)
        found["heads", mount.head, "position_m"] = metres(base.T)
        found["heads", mount.head, "rpy_deg"] = rpy_deg(base.T[:3, :3])
        found["cameras", name, "calibrated"] = today
    for name, mount_found in answer.found.mounts.items():
        found["cameras", name, "mount", "T_mount_camera"] = pose_of(without_optical(mount_found.T))
    return found | (dict(_anchors(answer)) if anchors else {})


def places_to_write(rig: Rig, cameras: Iterable[str], *, anchors: bool, mounts: bool) -> list[KeyPath]:
    """Return where ``changes`` may lead, before anything is found."""
    found: list[KeyPath] = []
    for name in cameras:
        mount = rig.cameras[name].mount
        found.append(("cameras", name, "calibrated"))
        if isinstance(mount, HeadMount):
            found += [("heads", mount.head, "position_m"), ("heads", mount.head, "rpy_deg")]
            found += [("cameras", name, "mount", "T_mount_camera")] if mounts else []
        else:
            found.append(("cameras", name, "mount", "fixed"))
    if anchors:
        found += [("anchors", k, "T_world_tag") for k in range(len(rig.anchors))] + [("anchors", len(rig.anchors))]
    return found


def in_words(new: Mapping[KeyPath, object]) -> dict[str, object]:
    """Return changes by their places as people and JSON name them: ``cameras.west.mount.fixed``."""
    return {
        ".".join(map(str, path)): value.isoformat() if isinstance(value, date) else value for path, value in new.items()
    }


def tell_unwritten(new: Mapping[KeyPath, object]) -> None:
    """Say what ``--write`` would set."""
    people.print("nothing was written; --write would set", highlight=False)
    for place, value in in_words(new).items():
        people.print(f"  {place}: {json.dumps(value)}", highlight=False, markup=False, soft_wrap=True)


def pose_of(T: Transform) -> dict[str, object]:
    """Return a pose as the file has it."""
    return {"position_m": metres(T), "rpy_deg": rpy_deg(T[:3, :3])}


def _fixed(T: Transform) -> dict[str, object]:
    pan, tilt, roll = (round(math.degrees(angle), 4) for angle in look_of(T[:3, :3]))
    return {"position_m": metres(T), "pan_deg": pan, "tilt_deg": tilt, "roll_deg": roll}


def today() -> date:
    """Return the date that ``calibrated`` and reports bear."""
    return datetime.now(tz=UTC).date()


def metres(T: Transform) -> list[float]:
    """Return a position as the file has it."""
    return [round(float(value), 5) for value in T[:3, 3]]


def _anchors(answer: Answer) -> Iterator[tuple[KeyPath, object]]:
    """Yield the tags of the room: those that the file has as anchors in their new place, others beside these."""
    listed = {str(anchor.key): k for k, anchor in enumerate(answer.rig.anchors)}
    added = len(listed)
    for mark, pose in answer.found.room.items():
        family, colon, number = mark.rpartition(":")
        if not colon:
            continue
        key = TagKey(family, int(number))
        if str(key) in listed:
            yield ("anchors", listed[str(key)], "T_world_tag"), pose_of(pose.T)
            continue
        entry = {
            "family": key.family,
            "id": key.id,
            "size_m": round(answer.setup.sizes_m[mark], 5),
            "T_world_tag": pose_of(pose.T),
        }
        yield ("anchors", added), entry
        added += 1
