"""Cameras and tags placed from pictures alone: cameras fixed to each other, tags fixed to each other, one moving.

Whether a rig of cameras is carried past tags on walls, or a board of tags past cameras on a ceiling, is the same
problem: the pose of the one in the other, by instant; the cameras in the rig; the tags on the board.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.adjust import Adjusted, adjust
from camrig.calibrate.chains import Chains
from camrig.calibrate.normal import TagViews
from camrig.calibrate.start import Placed, Sighted, agreed, place
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import TAG_CORNERS, observe_tags
from camrig.geometry.pose import invert

_ROUNDS = 3
"""How often all is adjusted, each time with the noise that the residuals of the time before showed."""

_AT_FIRST_PX = 1.0
"""The noise of the first time: generous, the poses are not good yet."""

_LEAST_PX = 1e-3
"""No corner is better than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The tags that one camera saw at one instant: (4, 2) corners p0..p3 in pixels (OpenCV's) by the tag's name."""

    camera_id: str
    instant: int
    corners_px: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """Where everything is.

    ``T_rig_camera`` by camera, the first of which is the rig; ``T_board_tag`` by tag, the one seen most often is the
    board; ``T_board_rig`` by instant. ``camera_covariance`` and ``tag_covariance`` (6, 6) as in geometry.pose, zero for
    the rig and the board themselves. ``sighted`` are the tags that ``adjusted`` has residuals of, in its order, and
    ``noise_px`` is one sigma of their corners. ``unplaced`` are the cameras and tags that hang on nothing else.
    """

    T_rig_camera: Mapping[str, Transform]
    T_board_tag: Mapping[str, Transform]
    T_board_rig: Mapping[int, Transform]
    camera_covariance: Mapping[str, Array]
    tag_covariance: Mapping[str, Array]
    sighted: tuple[Sighted, ...]
    adjusted: Adjusted
    noise_px: float
    unplaced: tuple[str, ...]


def extrinsics(shots: Sequence[Shot], lenses: Mapping[str, Lens], sizes_m: Mapping[str, float]) -> Extrinsics:
    """Place all cameras, instants and tags from nothing but the corners; lenses by camera, sizes by tag.

    All corners weigh alike: what prints, lenses and exposure do to them outweighs the noise of their pixels. Raises
    InputError where no camera shows a tag within its lens's ``r_max``.
    """
    sighted = tuple(each for name, lens in lenses.items() for each in _sighted(name, lens, shots, sizes_m))
    if not sighted:
        raise InputError("no camera shows a tag within the part of its picture for which its lens is calibrated")
    placed = place(sighted)
    rig = _rig(placed, tuple(lenses))
    instants = _instants(placed, rig)
    used = tuple(each for each in sighted if each.picture in placed.pictures and each.picture[0] in rig)
    used = tuple(each for each in used if each.tag in placed.tags)
    start = np.stack([*rig.values(), *instants.values(), *placed.tags.values()])
    held = np.zeros(len(start), dtype=bool)
    held[0] = held[len(rig) + len(instants)] = True
    views, noise_px = _views(used, tuple(rig), tuple(instants), tuple(placed.tags)), _AT_FIRST_PX
    for _ in range(_ROUNDS):
        views = replace(views, sigma_px=np.full_like(views.sigma_px, noise_px))
        adjusted = adjust(views, [lenses[name] for name in rig], start, held)
        start, noise_px = adjusted.T, max(noise_px * adjusted.noise_factor(), _LEAST_PX)
    cameras = {name: k for k, name in enumerate(rig)}
    tags = {name: len(rig) + len(instants) + k for k, name in enumerate(placed.tags)}
    return Extrinsics(
        T_rig_camera={name: adjusted.T[k] for name, k in cameras.items()},
        T_board_tag={name: adjusted.T[k] for name, k in tags.items()},
        T_board_rig={name: adjusted.T[len(rig) + k] for k, name in enumerate(instants)},
        camera_covariance={name: adjusted.covariance_of(k) for name, k in cameras.items()},
        tag_covariance={name: adjusted.covariance_of(k) for name, k in tags.items()},
        sighted=used,
        adjusted=adjusted,
        noise_px=noise_px,
        unplaced=tuple(sorted(({*lenses} - {*rig}) | ({each.tag for each in sighted} - {*tags}))),
    )


def _sighted(camera_id: str, lens: Lens, shots: Sequence[Shot], sizes_m: Mapping[str, float]) -> Iterator[Sighted]:
    """Undistort and weigh all tags of one camera; leaves out those with a corner past the lens's ``r_max``."""
    found = [
        ((camera_id, shot.instant), tag, corners_px)
        for shot in shots
        if shot.camera_id == camera_id
        for tag, corners_px in shot.corners_px.items()
    ]
    if not found:
        return
    points = observe_tags(lens, np.stack([corners_px for _, _, corners_px in found]))
    for k in np.flatnonzero(np.isfinite(points.ideal).all(axis=(1, 2))):
        picture, tag, corners_px = found[k]
        yield Sighted(picture, tag, sizes_m[tag], sizes_m[tag] * TAG_CORNERS, corners_px, points.of(int(k)))


def _rig(placed: Placed, names: Sequence[str]) -> dict[str, Transform]:
    """Return ``T_rig_camera`` of the first camera that is placed, the rig, and of all that were seen with it or with
    others so placed.
    """
    by_camera = {
        name: {instant: invert(T) for (camera, instant), T in placed.pictures.items() if camera == name}
        for name in names
    }
    first = next(name for name in names if by_camera[name])
    rig = {first: np.eye(4)}
    while True:
        shared = {
            (known, name): by_camera[known].keys() & by_camera[name].keys()
            for known in rig
            for name in names
            if name not in rig
        }
        best = max(shared, key=lambda pair: len(shared[pair]), default=None)
        if best is None or not shared[best]:
            return rig
        known, name = best
        relative = agreed(invert(by_camera[known][k]) @ by_camera[name][k] for k in sorted(shared[best]))
        rig[name] = rig[known] @ relative


def _instants(placed: Placed, rig: Mapping[str, Transform]) -> dict[int, Transform]:
    """Return ``T_board_rig`` at each instant of which a camera of the rig was placed."""
    by_instant: dict[int, list[Transform]] = {}
    for (camera, instant), T_camera_board in placed.pictures.items():
        if camera in rig:
            by_instant.setdefault(instant, []).append(invert(rig[camera] @ T_camera_board))
    return {instant: agreed(by_instant[instant]) for instant in sorted(by_instant)}


def _views(sighted: Sequence[Sighted], rig: Sequence[str], instants: Sequence[int], tags: Sequence[str]) -> TagViews:
    """Write out the tags; poses are those of the rig's cameras, then of the instants, then of the tags."""
    camera = np.array([rig.index(each.picture[0]) for each in sighted], dtype=np.int64)
    places = {name: len(rig) + k for k, name in enumerate(instants)}
    instant = np.array([places[each.picture[1]] for each in sighted], dtype=np.int64)
    tag = np.array([len(rig) + len(instants) + tags.index(each.tag) for each in sighted], dtype=np.int64)
    return TagViews(
        lens=camera,
        chains=Chains(np.stack([instant, camera], axis=1), tag[:, None]),
        corners_m=np.stack([each.corners_m for each in sighted]),
        pixels=np.stack([each.pixels for each in sighted]),
        sigma_px=np.ones((len(sighted), 4)),
    )
