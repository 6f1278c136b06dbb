"""Tags seen through chains of poses: where their corners are in the camera, and how each pose of the chain moves them.

A camera may hang on a rig, a rig in the room, a tag on a board, a board in a hand: on either side of the world stands a
product of poses, some unknown, some known, any of them shared by many views.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """By which of n poses each of m views hangs together; -1 is no pose.

    ``camera`` (m, k): T_world_camera = T[camera[0]] T[camera[1]] ...; ``tag`` (m, l): T_world_tag likewise.
    """

    camera: Indices
    tag: Indices

    @property
    def columns(self) -> Indices:
        """The (m, k + l) poses that a view depends on."""
        return np.concatenate([self.camera, self.tag], axis=1)

    def only(self, kept: npt.NDArray[np.bool_] | slice) -> Chains:
        """Return those of some of the views."""
        return Chains(self.camera[kept], self.tag[kept])


def points_in_camera(T: Array, chains: Chains, corners_m: Array) -> Array:
    """Map (m, 4, 3) corners in their tag's frame into the optical frame of the camera, by (n, 4, 4) poses."""
    points = corners_m
    for column in chains.tag.T[::-1]:
        R, t = _parts(T, column)
        points = points @ R.swapaxes(1, 2) + t[:, None]
    for column in chains.camera.T:
        R, t = _parts(T, column)
        points = (points - t[:, None]) @ R
    return points


def slopes_in_camera(T: Array, chains: Chains, corners_m: Array) -> tuple[Array, Array]:
    """Return the (m, 4, 3) points of ``points_in_camera`` and their derivative (m, 4, 3, k + l, 6) by the error
    (geometry.pose) of each pose of the chain; zero where there is none.
    """
    m, (k, l) = len(corners_m), (chains.camera.shape[1], chains.tag.shape[1])
    slopes = np.zeros((m, corners_m.shape[1], 3, k + l, 6))
    points = corners_m
    for at in range(l)[::-1]:
        R, t = _parts(T, chains.tag[:, at])
        points = points @ R.swapaxes(1, 2)
        slopes[..., at + k + 1 :, :] = _turned(R, slopes[..., at + k + 1 :, :])
        slopes[..., at + k, :] = _pose_slopes(points)
        points = points + t[:, None]
    for at in range(k):
        R, t = _parts(T, chains.camera[:, at])
        points = points - t[:, None]
        slopes[..., at, :] = -_pose_slopes(points)
        done = [*range(at + 1), *range(k, k + l)]
        slopes[..., done, :] = _turned(R.swapaxes(1, 2), slopes[..., done, :])
        points = points @ R
    slopes *= (chains.columns >= 0)[:, None, None, :, None]
    return points, slopes


def _parts(T: Array, column: Indices) -> tuple[Array, Array]:
    """Return the (m, 3, 3) rotations and (m, 3) translations of one link; those of no pose change nothing."""
    taken = np.where((column >= 0)[:, None, None], T[column], np.eye(4))
    return taken[:, :3, :3], taken[:, :3, 3]


def _pose_slopes(arms: Array) -> Array:
    """Return (m, 4, 3, 6): d (t + R p) by [d, r] is [I, -skew(R p)], where R p is the arm."""
    x, y, z = arms[..., 0], arms[..., 1], arms[..., 2]
    slopes = np.zeros((*arms.shape, 6))
    slopes[..., 0, 0] = slopes[..., 1, 1] = slopes[..., 2, 2] = 1.0
    slopes[..., 0, 4], slopes[..., 0, 5] = z, -y
    slopes[..., 1, 3], slopes[..., 1, 5] = -z, x
    slopes[..., 2, 3], slopes[..., 2, 4] = y, -x
    return slopes


def _turned(R: Array, slopes: Array) -> Array:
    """Turn the (m, 4, 3, j, 6) slopes of points by (m, 3, 3) rotations."""
    m, corners, _, j, _ = slopes.shape
    flat = slopes.reshape(m, corners, 3, j * 6)
    return np.asarray((R[:, None] @ flat).reshape(slopes.shape))
