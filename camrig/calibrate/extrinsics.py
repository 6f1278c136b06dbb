"""Cameras placed from pictures alone: what stands in the room, what is carried past, cameras bolted or on heads.

Whether a board of tags is carried past cameras on a ceiling or a rig of cameras past tags on walls is one problem: the
cameras in the world (or the rig, where that is what moves), the board in it by instant, the tags on the board. Anchors,
marks of known place in the world, put everything in its place, as do cameras of known place; without either the first
camera is the world. A head's angles count as what they are: read with an error of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camrig.calibrate.adjust import Adjusted, adjust
from camrig.calibrate.links import Links
from camrig.calibrate.poses import Poses
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import ROOM, Shot, Sighted, sighted
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform

_ROUNDS = 3
"""How often all is adjusted, each time with the noise that the residuals of the time before showed."""

_AT_FIRST_PX = 1.0
"""The noise of the first time: generous, the poses are not good yet."""

_LEAST_PX = 1e-3
"""No corner is better than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertain:
    """A pose, and its (6, 6) covariance (geometry.pose): zero for what was held."""

    T: Transform
    covariance: Array

    @property
    def sigma_mm(self) -> Array:
        """One sigma (3,) of its place along the world's axes."""
        return np.asarray(1e3 * np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def sigma_deg(self) -> float:
        """One sigma of its direction, about the worst axis."""
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1])))


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """Where everything is.

    ``cameras``: ``T_world_camera`` of those that no head carries; ``bases``: ``T_world_base`` of the heads of the
    others, ``mounts`` their ``T_mount_camera`` where that was asked, ``aims_off_deg`` by how much pan and tilt at each
    stop differ from what the head said - all by the camera's name. ``room``: ``T_world_mark`` of what stands in it;
    ``body_marks``: ``T_body_mark`` of what is carried, in the frame of the one of which most was seen; ``T_world_body``
    by body and instant. ``sighted`` are the marks in pictures with their ``residual_px`` (n, 2), ``noise_px`` is one
    sigma of them. ``shared`` tells how much ties two cameras: instants at which both saw a body, and marks of the room
    in both. ``unplaced`` are the cameras and marks that hang on nothing else, ``lost`` the pictures.
    """

    cameras: Mapping[str, Uncertain]
    bases: Mapping[str, Uncertain]
    mounts: Mapping[str, Uncertain]
    aims_off_deg: Mapping[str, Array]
    room: Mapping[str, Uncertain]
    body_marks: Mapping[str, Uncertain]
    body_of: Mapping[str, str]
    T_world_body: Mapping[tuple[str, int], Transform]
    sighted: tuple[Sighted, ...]
    residual_px: tuple[Array, ...]
    rms_px: float
    median_px: float
    noise_px: float
    anchored: bool
    shared: Mapping[tuple[str, str], int]
    unplaced: tuple[str, ...]

    @property
    def placed_cameras(self) -> Mapping[str, Uncertain]:
        """All cameras that are placed, those on heads by their heads' bases."""
        return {**self.cameras, **self.bases}

    def of_camera(self, name: str) -> Array:
        """Return the (k, 2) pixels and (k, 2) residuals of a camera side by side, (k, 4)."""
        own = [
            np.hstack([each.pixels, off])
            for each, off in zip(self.sighted, self.residual_px, strict=True)
            if each.picture.camera == name
        ]
        return np.concatenate(own) if own else np.zeros((0, 4))


def extrinsics(shots: Sequence[Shot], setup: Setup) -> Extrinsics:
    """Place all cameras, bodies by instant and marks from what pictures show.

    All points weigh alike: what prints, lenses and exposure do to them outweighs the noise of their pixels. Raises
    InputError where no camera shows a mark within its lens's ``r_max``.
    """
    seen = sighted(shots, setup.lenses, setup.sizes_m, setup.still)
    if not seen:
        raise InputError(
            "no camera shows a tag or a board within the part of its picture for which its lens is calibrated"
        )
    links = Links(setup, shots, seen)
    used = tuple(each for each in seen if links.is_placed(each))
    links.keep({each.picture.camera for each in used})
    poses = Poses(setup, links, shots, used)
    adjusted, noise_px = _adjusted(poses)

    def found(kind: str, name: str) -> Uncertain:
        pose = poses.at(kind, name)
        return Uncertain(adjusted.T[pose], adjusted.covariance_of(pose))

    marks = [name for name, _ in poses.names("mark")]
    bases = [name for name, _ in poses.names("base")]
    ends = np.cumsum([len(each.pixels) for each in used])[:-1]
    body_of = {name: setup.body_of(name) for name in marks}
    return Extrinsics(
        cameras={name: found("base", name) for name in bases if name not in setup.heads},
        bases={name: found("base", name) for name in bases if name in setup.heads},
        mounts={name: found("mount", name) for name in bases if name in setup.heads and setup.heads[name].find_mount},
        aims_off_deg={name: _aims_off_deg(poses, adjusted, name) for name in bases if name in setup.heads},
        room={name: found("mark", name) for name in marks if body_of[name] == ROOM},
        body_marks={name: found("mark", name) for name in marks if body_of[name] != ROOM},
        body_of=body_of,
        T_world_body={(name, k): adjusted.T[poses.at("body", name, k)] for name, k in poses.names("body")},
        sighted=used,
        residual_px=tuple(np.split(adjusted.residual_px[adjusted.counts], ends)),
        rms_px=adjusted.rms_px,
        median_px=adjusted.median_px,
        noise_px=noise_px,
        anchored=links.anchored,
        shared=links.shared(),
        unplaced=tuple(sorted((setup.lenses.keys() - {*bases}) | ({each.mark for each in seen} - {*marks}))),
    )


def _adjusted(poses: Poses) -> tuple[Adjusted, float]:
    """Return all poses adjusted with the noise that their own residuals show, and that noise in pixels."""
    noise_px, start = _AT_FIRST_PX, poses.start
    for _ in range(_ROUNDS):
        views = replace(poses.views, sigma_px=noise_px * poses.views.sigma_px)
        adjusted = adjust(views, poses.lenses, start, poses.held, priors=poses.priors)
        start, noise_px = adjusted.T, max(noise_px * adjusted.noise_factor(), _LEAST_PX)
    return adjusted, noise_px


def _aims_off_deg(poses: Poses, adjusted: Adjusted, name: str) -> Array:
    """Return by how much (k, 2) pan and tilt at a head's stops differ from what it said: pan about the base's z, tilt
    about the mount's -y.
    """
    off = []
    for prior, pose in enumerate(poses.priors.poses):
        if poses.stop_of(int(pose)) == name:
            r = poses.priors.misses(adjusted.T)[prior, 3:]
            off.append([r[2], -r @ poses.priors.T[prior][:3, 1]])
    return np.degrees(np.array(off).reshape(-1, 2))
