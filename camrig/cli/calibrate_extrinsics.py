"""``camrig calibrate extrinsics``: where a rig's cameras are, from pictures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from camrig import pictures
from camrig.calibrate.extrinsics import Extrinsics, Shot
from camrig.calibrate.extrinsics import extrinsics as place_cameras
from camrig.cli.console import people, print_json, progress_bar, results
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig, load_rig
from camrig.detect import detect_tags, warm_up
from camrig.errors import InputError, PartialError
from camrig.geometry.arrays import Array
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation
from camrig.geometry.pose import difference
from camrig.geometry.rotation import rotation_log
from camrig.interfaces import TagDetector
from camrig.messages import Frame
from camrig.rig import FixedMount, Rig

NOISY_PX = 1.0
"""Corners that miss by more than this, one sigma, are not those of a stiff board and right lenses."""

LOOSE_SHARE = 0.5
LOOSE_SIGMAS = 8.0
"""A tag of which so many corners miss by so much does not move with the board."""

FEW_INSTANTS = 5
"""Two cameras that saw the board together at fewer instants are tied loosely."""

STRAIGHT = 0.02
"""Sine of the angle within which a camera looks straight up or down."""


def extrinsics(
    config: Annotated[Path, typer.Argument(help="The rig's YAML file: cameras, lenses, sizes of tags, anchors.")],
    from_images: Annotated[
        list[str],
        typer.Option(metavar="CAMERA=PICTURES", help="A camera's pictures: folder, glob or video."),
    ],
    tag_size_m: Annotated[
        float | None, typer.Option(help="Side of the black square of tags that the file does not list.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Place cameras by a board of tags that was carried past them, and by the anchors that they see.

    The board is anything stiff with tags on it; where they are on it is found too. Pictures of one instant bear the
    same number, the last in their file's name; of a video the number of the frame counts. Cameras keep still. With
    anchors of the file in view cameras are placed in the world, else relative to the first. Nothing is written. Exit
    code 4 where a camera or a picture could not be used.
    """
    rig_config = load_rig(config)
    rig = rig_config.rig
    places = _places(from_images, rig)
    sizes_m = _listed_sizes_m(rig)
    shots, faults = _shots(rig_config, places, hidden=as_json)
    seen = {tag for shot in shots for tag in shot.corners_px}
    unsized = sorted(seen - sizes_m.keys())
    if unsized and tag_size_m is None:
        raise InputError(f"{config} does not list {', '.join(unsized)}: give their size, --tag-size-m")
    sizes_m |= {tag: tag_size_m for tag in unsized if tag_size_m is not None}
    lenses = {name: rig.cameras[name].lens for name in places}
    anchors = {str(anchor.key): anchor.T_world_tag for anchor in rig.anchors}
    with people.status("placing cameras"):
        found = place_cameras(shots, lenses, sizes_m, {tag: T for tag, T in anchors.items() if tag in seen})
    warnings = tuple(_warnings(found))
    if as_json:
        print_json(_as_json(found, warnings, rig))
    else:
        _print(found, warnings, rig)
    lost = [f"{name} shares no tag with the others: hangs on nothing" for name in places if name in found.unplaced]
    if faults or lost:
        raise PartialError("\n".join([*lost, *faults]))


def _places(given: Sequence[str], rig: Rig) -> dict[str, str]:
    """Return where each camera's pictures are."""
    places: dict[str, str] = {}
    for each in given:
        name, equals, place = each.partition("=")
        if not equals or not place:
            raise InputError(f"--from-images {each}: write CAMERA=PICTURES, as in --from-images north=walk/north")
        if name not in rig.cameras:
            raise InputError(f"--from-images: rig '{rig.name}' has no camera '{name}'; it has {', '.join(rig.cameras)}")
        if name in places:
            raise InputError(f"--from-images: '{name}' is there twice; put its pictures into one folder")
        places[name] = place
    return places


def _listed_sizes_m(rig: Rig) -> dict[str, float]:
    sizes_m = {str(tag.key): tag.size_m for body in rig.targets.values() for tag in body.tags}
    return sizes_m | {str(anchor.key): anchor.size_m for anchor in rig.anchors}


def _shots(config: RigConfig, places: Mapping[str, str], *, hidden: bool) -> tuple[list[Shot], list[str]]:
    """Find the tags in all pictures; return them, and a sentence for each picture that cannot be used."""
    files = {name: pictures.find(place) for name, place in places.items()}
    detector: TagDetector = config.detector.plugin.make(config.detector.section)
    if config.refine:
        with people.status("loading refinement; after an installation it is compiled once, for a quarter of a minute"):
            warm_up()
    shots: list[Shot] = []
    faults: list[str] = []
    with progress_bar("detecting", sum(pictures.count(paths) for paths in files.values()), hidden=hidden) as progress:
        for name, paths in files.items():
            for found in _seen(config, name, paths, detector):
                if isinstance(found, Shot):
                    shots.append(found)
                else:
                    faults.append(found)
                progress.advance(progress.task_ids[0])
    return shots, faults


def _seen(config: RigConfig, name: str, paths: Sequence[Path], detector: TagDetector) -> Iterator[Shot | str]:
    lens = config.rig.cameras[name].lens
    for picture in pictures.read(paths):
        about = f"{picture.path} [{picture.frame}]" if pictures.is_video(picture.path) else str(picture.path)
        instant = _instant(picture)
        if picture.image is None:
            yield f"{about}: {picture.fault}"
        elif instant is None:
            yield f"{about}: has no number in its name, which tells pictures of one instant"
        elif (size := picture.image.shape[::-1]) != lens.size_px:
            yield f"{about}: is {size[0]}x{size[1]} px, {name}'s lens {lens.size_px[0]}x{lens.size_px[1]} px"
        else:
            frame = Frame(name, picture.image, 0.0, instant, stamp_known=False, source=about)
            found = detect_tags(frame, detector, RealClock().now_s, lens=lens if config.refine else None)
            yield Shot(name, instant, {str(tag.key): tag.corners_px for tag in found.tags})


def _instant(picture: pictures.Picture) -> int | None:
    if pictures.is_video(picture.path):
        return picture.frame
    numbers = re.findall(r"\d+", picture.path.stem)
    return int(numbers[-1]) if numbers else None


def _warnings(found: Extrinsics) -> Iterator[str]:
    if found.noise_px > NOISY_PX:
        yield f"corners miss by {found.noise_px:.1f} px: the board bends, a camera moved, or a lens or size is wrong"
    missed = np.linalg.norm(found.adjusted.residual_px, axis=-1) > LOOSE_SIGMAS * found.noise_px
    for tag in sorted({each.tag for each in found.sighted}):
        share = float(missed[[each.tag == tag for each in found.sighted]].mean())
        if share > LOOSE_SHARE:
            yield f"{tag} does not keep its place: {100.0 * share:.0f} % of its corners are elsewhere; leave it out"
    for (a, b), count in found.shared.items():
        if 0 < count < FEW_INSTANTS:
            yield f"{a} and {b} saw the board together at only {count} instants: walk it where both see it"


@dataclass(frozen=True, slots=True)
class _Placed:
    """A camera as people read it; how it looks as a rig's file says it, and the turn about its axis, which that cannot
    say; how far that is from the file's own word, None where there is none.
    """

    position_m: list[float]
    sigma_mm: list[float]
    sigma_deg: float
    pan_deg: float
    tilt_deg: float
    roll_deg: float
    off_file_mm: float | None
    off_file_deg: float | None


def _placed(found: Extrinsics, name: str, rig: Rig) -> _Placed:
    T, variance = found.T_world_camera[name], np.diag(found.camera_covariance[name])
    pan_rad, tilt_rad, roll_rad = _looks(T[:3, :3])
    off_mm, off_deg = None, None
    mount = rig.cameras[name].mount
    if found.anchored and isinstance(mount, FixedMount):
        off = difference(T, mount.T_world_camera)
        off_mm, off_deg = 1e3 * float(np.linalg.norm(off[:3])), math.degrees(np.linalg.norm(off[3:]))
    return _Placed(
        position_m=np.round(T[:3, 3], 5).tolist(),
        sigma_mm=np.round(1e3 * np.sqrt(variance[:3]), 3).tolist(),
        sigma_deg=math.degrees(np.sqrt(variance[3:].max())),
        pan_deg=round(math.degrees(pan_rad), 3),
        tilt_deg=round(math.degrees(tilt_rad), 3),
        roll_deg=round(math.degrees(roll_rad), 3),
        off_file_mm=None if off_mm is None else round(off_mm, 2),
        off_file_deg=None if off_deg is None else round(off_deg, 3),
    )


def _looks(R_world_camera: Array) -> tuple[float, float, float]:
    """Return pan, tilt and roll in radians; of a camera that looks straight up or down the turn is all pan."""
    _, image_down, (x, y, z) = R_world_camera.T
    if math.hypot(x, y) < STRAIGHT:
        x, y = np.copysign(1.0, z) * image_down[:2]
    pan_rad, tilt_rad = math.atan2(y, x), math.asin(min(max(z, -1.0), 1.0))
    level = aim_rotation(pan_rad, tilt_rad) @ R_MOUNT_OPTICAL
    return pan_rad, tilt_rad, float(rotation_log(level.T @ R_world_camera)[2])


def _print(found: Extrinsics, warnings: Sequence[str], rig: Rig) -> None:
    first = next(iter(found.T_world_camera))
    world = "Cameras in the world" if found.anchored else f"Cameras as {first} sees them: no anchor in view"
    table = Table("camera", "position m", "± mm", "pan, tilt, roll deg", "± deg", "file off by", title=world)
    for name in found.T_world_camera:
        each = _placed(found, name, rig)
        table.add_row(
            name,
            ", ".join(f"{value:.4f}" for value in each.position_m),
            ", ".join(f"{value:.2f}" for value in each.sigma_mm),
            f"{each.pan_deg:.2f}, {each.tilt_deg:.2f}, {each.roll_deg:.2f}",
            f"{each.sigma_deg:.3f}",
            "" if each.off_file_mm is None else f"{each.off_file_mm:.1f} mm, {each.off_file_deg:.2f} deg",
        )
    results.print(table)
    adjusted = found.adjusted
    results.print(
        f"{len(found.sighted)} tags in pictures, {len(found.T_world_board)} instants; corners miss by "
        f"{adjusted.median_px:.2f} px (median; rms {adjusted.rms_px:.2f})",
        highlight=False,
    )
    for warning in warnings:
        people.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)


def _as_json(found: Extrinsics, warnings: Sequence[str], rig: Rig) -> dict[str, object]:
    return {
        "rms_px": round(found.adjusted.rms_px, 4),
        "median_px": round(found.adjusted.median_px, 4),
        "anchored": found.anchored,
        "cameras": {
            name: {"T_world_camera": T.tolist(), **asdict(_placed(found, name, rig))}
            for name, T in found.T_world_camera.items()
        },
        "tags": {name: {"T_board_tag": T.tolist()} for name, T in found.T_board_tag.items()},
        "links": [{"cameras": list(pair), "instants": count} for pair, count in found.shared.items() if count],
        "missing_links": [list(pair) for pair, count in found.shared.items() if not count],
        "unplaced": list(found.unplaced),
        "warnings": list(warnings),
    }
