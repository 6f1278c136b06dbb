"""Cameras placed from pictures alone: cameras fixed to each other, tags fixed to each other, one moving past the other.

Whether a board of tags is carried past cameras on a ceiling or a rig of cameras past tags on walls is one problem: the
cameras in the world (or the rig, where that is what moves), the board in it by instant, the tags on the board. Anchors,
tags of known place in the world, put everything in its place; without one the first camera is the world.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

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

_ALWAYS = -1
"""The instant of anchors: they are there in every picture of a camera."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The tags that one camera saw at one instant: (4, 2) corners p0..p3 in pixels (OpenCV's) by the tag's name."""

    camera_id: str
    instant: int
    corners_px: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """Where everything is.

    ``T_world_camera`` by camera, ``T_world_board`` by instant, ``T_board_tag`` by tag; the board is the tag seen most
    often. ``camera_covariance`` and ``tag_covariance`` (6, 6) as in geometry.pose, zero for what was held: the board's
    own tag and, where no anchor was seen, the first camera. ``sighted`` are the tags that ``adjusted`` has residuals
    of, in its order, and ``noise_px`` is one sigma of their corners. ``shared`` tells at how many instants two cameras
    saw the board together; ``unplaced`` are the cameras and tags that hang on nothing else.
    """

    T_world_camera: Mapping[str, Transform]
    T_world_board: Mapping[int, Transform]
    T_board_tag: Mapping[str, Transform]
    camera_covariance: Mapping[str, Array]
    tag_covariance: Mapping[str, Array]
    sighted: tuple[Sighted, ...]
    adjusted: Adjusted
    noise_px: float
    anchored: bool
    shared: Mapping[tuple[str, str], int]
    unplaced: tuple[str, ...]


def extrinsics(
    shots: Sequence[Shot],
    lenses: Mapping[str, Lens],
    sizes_m: Mapping[str, float],
    anchors: Mapping[str, Transform] | None = None,
) -> Extrinsics:
    """Place all cameras, instants and tags from corners; lenses by camera, sizes by tag, ``T_world_tag`` of anchors.

    All corners weigh alike: what prints, lenses and exposure do to them outweighs the noise of their pixels. Raises
    InputError where no camera shows a tag within its lens's ``r_max``.
    """
    known = anchors or {}
    sighted = tuple(each for name, lens in lenses.items() for each in _sighted(name, lens, shots, sizes_m, known))
    if not sighted:
        raise InputError("no camera shows a tag within the part of its picture for which its lens is calibrated")
    walked, still = (tuple(each for each in sighted if (each.tag in known) is anchor) for anchor in (False, True))
    board = place(walked) if walked else Placed({}, {})
    anchored = {camera: invert(T) for (camera, _), T in place(still, known).pictures.items()} if still else {}
    cameras = _in_world(_rig(board, tuple(lenses)), anchored)
    instants = _instants(board, cameras)
    used = tuple(each for each in sighted if each.picture[0] in cameras and _is_placed(each, board, known))
    seen = {each.tag for each in used}
    tags = {name: T for name, T in board.tags.items() if name in seen}
    order = _Order(tuple(cameras), tuple(instants), tuple(tags), tuple(known))
    start = np.stack([*cameras.values(), *instants.values(), *tags.values(), *known.values()])
    adjusted, noise_px = _adjusted(
        order.views(used), [lenses[name] for name in cameras], start, order.held(bool(anchored))
    )
    return Extrinsics(
        T_world_camera={name: adjusted.T[order.camera(name)] for name in cameras},
        T_world_board={name: adjusted.T[order.instant(name)] for name in instants},
        T_board_tag={name: adjusted.T[order.tag(name)] for name in tags},
        camera_covariance={name: adjusted.covariance_of(order.camera(name)) for name in cameras},
        tag_covariance={name: adjusted.covariance_of(order.tag(name)) for name in tags},
        sighted=used,
        adjusted=adjusted,
        noise_px=noise_px,
        anchored=bool(anchored),
        shared=_shared(board, tuple(lenses)),
        unplaced=tuple(sorted(({*lenses} - {*cameras}) | ({each.tag for each in walked} - {*tags}))),
    )


@dataclass(frozen=True, slots=True)
class _Order:
    """In which order poses are adjusted: of cameras, of the board by instant, of its tags, of anchors."""

    cameras: tuple[str, ...]
    instants: tuple[int, ...]
    tags: tuple[str, ...]
    anchors: tuple[str, ...]

    def camera(self, name: str) -> int:
        return self.cameras.index(name)

    def instant(self, name: int) -> int:
        """Return the place of the board's pose at an instant; of an anchor, which no board carries, none: -1."""
        return -1 if name == _ALWAYS else len(self.cameras) + self.instants.index(name)

    def tag(self, name: str) -> int:
        return len(self.cameras) + len(self.instants) + (*self.tags, *self.anchors).index(name)

    def held(self, anchored: bool) -> npt.NDArray[np.bool_]:
        """Hold the anchors or, without, the first camera; and the first tag, or board and tags could change places."""
        held = np.zeros(len(self.cameras) + len(self.instants) + len(self.tags) + len(self.anchors), dtype=bool)
        held[0] = not anchored
        held[len(self.cameras) + len(self.instants) :][: min(1, len(self.tags))] = True
        held[len(held) - len(self.anchors) :] = True
        return held

    def views(self, sighted: Sequence[Sighted]) -> TagViews:
        """Write out tags in pictures."""
        camera = np.array([self.camera(each.picture[0]) for each in sighted], dtype=np.int64)
        return TagViews(
            lens=camera,
            chains=Chains(
                camera[:, None],
                np.array([(self.instant(each.picture[1]), self.tag(each.tag)) for each in sighted], dtype=np.int64),
            ),
            corners_m=np.stack([each.corners_m for each in sighted]),
            pixels=np.stack([each.pixels for each in sighted]),
            sigma_px=np.ones((len(sighted), 4)),
        )


def _adjusted(
    views: TagViews, lenses: Sequence[Lens], start: Array, held: npt.NDArray[np.bool_]
) -> tuple[Adjusted, float]:
    """Return all poses adjusted with the noise that their own residuals show, and that noise in pixels."""
    noise_px = _AT_FIRST_PX
    for _ in range(_ROUNDS):
        views = replace(views, sigma_px=np.full_like(views.sigma_px, noise_px))
        adjusted = adjust(views, lenses, start, held)
        start, noise_px = adjusted.T, max(noise_px * adjusted.noise_factor(), _LEAST_PX)
    return adjusted, noise_px


def _sighted(
    camera_id: str,
    lens: Lens,
    shots: Sequence[Shot],
    sizes_m: Mapping[str, float],
    anchors: Mapping[str, Transform],
) -> Iterator[Sighted]:
    """Undistort all tags of one camera, anchors once; leaves out those with a corner past the lens's ``r_max``."""
    found, still = [], dict[str, list[Array]]()
    for shot in shots:
        for tag, corners_px in shot.corners_px.items() if shot.camera_id == camera_id else ():
            if tag in anchors:
                still.setdefault(tag, []).append(corners_px)
            else:
                found.append(((camera_id, shot.instant), tag, corners_px))
    # Neither moves, so most of their corners' noise is the same in each picture: many are worth hardly more than one.
    found += [((camera_id, _ALWAYS), tag, np.median(each, axis=0)) for tag, each in still.items()]
    if not found:
        return
    points = observe_tags(lens, np.stack([corners_px for _, _, corners_px in found]))
    for k in np.flatnonzero(np.isfinite(points.ideal).all(axis=(1, 2))):
        picture, tag, corners_px = found[k]
        yield Sighted(picture, tag, sizes_m[tag], sizes_m[tag] * TAG_CORNERS, corners_px, points.of(int(k)))


def _is_placed(each: Sighted, board: Placed, anchors: Mapping[str, Transform]) -> bool:
    return each.tag in anchors or (each.picture in board.pictures and each.tag in board.tags)


def _rig(placed: Placed, names: Sequence[str]) -> dict[str, Transform]:
    """Return ``T_rig_camera`` of the first camera that is placed, the rig, and of all that were seen with it or with
    others so placed.
    """
    by_camera = {
        name: {instant: invert(T) for (camera, instant), T in placed.pictures.items() if camera == name}
        for name in names
    }
    rig = {name: np.eye(4) for name in [name for name in names if by_camera[name]][:1]}
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


def _in_world(rig: Mapping[str, Transform], anchored: Mapping[str, Transform]) -> dict[str, Transform]:
    """Return ``T_world_camera`` of all cameras that board and anchors place; without anchors the rig is the world.

    With anchors, cameras that the board ties together, none of which sees an anchor, hang on nothing.
    """
    if not anchored:
        return dict(rig)
    both = [T @ invert(rig[name]) for name, T in anchored.items() if name in rig]
    return {**{name: agreed(both) @ T for name, T in rig.items() if both}, **anchored}


def _instants(placed: Placed, cameras: Mapping[str, Transform]) -> dict[int, Transform]:
    """Return ``T_world_board`` at each instant at which a camera was placed by the board."""
    by_instant: dict[int, list[Transform]] = {}
    for (camera, instant), T_camera_board in placed.pictures.items():
        if camera in cameras:
            by_instant.setdefault(instant, []).append(cameras[camera] @ T_camera_board)
    return {instant: agreed(by_instant[instant]) for instant in sorted(by_instant)}


def _shared(placed: Placed, names: Sequence[str]) -> dict[tuple[str, str], int]:
    """Return at how many instants each two cameras saw the board together."""
    instants = {name: {instant for camera, instant in placed.pictures if camera == name} for name in names}
    return {(a, b): len(instants[a] & instants[b]) for k, a in enumerate(names) for b in names[k + 1 :]}
