"""What a pan-tilt head is like, and where its camera then sees fixed tags.

The kinematics are those of geometry.pan_tilt, the two axes neither meeting nor square to each other. Several poses and
angles say the same thing twice; by convention the zeros are the angles' own: the base keeps its heading and its height
along the pan axis against ``T_arm_tilt``, the camera its pitch on the mount, the tilt axis its point beside the arm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from camrig.calibrate.chains import Chains, Indices, slopes_in_camera
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pan_tilt import PanTilt
from camrig.geometry.pnp import TAG_CORNERS, observe_tags
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_exp, rotation_y, rotation_z

PAN, TILT = 0, 1
_NEAREST_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class HeadShot:
    """What a head's camera saw of fixed tags while the head was at rest.

    ``reported_rad`` (2,) is pan and tilt as the head reported them when its motor last dragged the optics along;
    ``travel`` (2,) tells towards which reports that was (+1 growing, -1 falling, 0 unknown). ``corners_px`` by tag are
    (4, 2), of ``pictures`` pictures the mean; ``aim_rad`` (2,) is where it was sent.
    """

    reported_rad: Array
    travel: Array
    corners_px: Mapping[str, Array]
    stamp_s: float = 0.0
    pictures: int = 1
    aim_rad: Array | None = None


@dataclass(frozen=True, slots=True)
class AxisModel:
    """From what an axis reports to where its optics are.

    ``angle = line + sine_rad sin(line) + cosine_rad cos(line)`` of ``line = factor (report - pivot_rad) + pivot_rad +
    offset_rad``, behind by half the play on the side from which it came.
    """

    pivot_rad: float = 0.0
    factor: float = 1.0
    offset_rad: float = 0.0
    play_rad: float = 0.0
    sine_rad: float = 0.0
    cosine_rad: float = 0.0

    def line_rad(self, reported_rad: Array) -> Array:
        """Return the part that is linear; any shape."""
        return np.asarray(self.factor * (reported_rad - self.pivot_rad) + self.pivot_rad + self.offset_rad)

    def angle_rad(self, reported_rad: Array, travel: Array) -> Array:
        """Return where the optics are; any shape."""
        line_rad = self.line_rad(reported_rad)
        bend_rad = self.sine_rad * np.sin(line_rad) + self.cosine_rad * np.cos(line_rad)
        return np.asarray(line_rad + bend_rad - 0.5 * self.play_rad * travel * np.sign(self.factor))

    def slopes(self, reported_rad: Array, travel: Array) -> Array:
        """Return (n, 5): the angles' derivative by factor, offset, play, sine and cosine."""
        line_rad = self.line_rad(reported_rad)
        bend = 1.0 + self.sine_rad * np.cos(line_rad) - self.cosine_rad * np.sin(line_rad)
        by_play = -0.5 * travel * math.copysign(1.0, self.factor)
        columns = [bend * (reported_rad - self.pivot_rad), bend, by_play, np.sin(line_rad), np.cos(line_rad)]
        return np.stack(columns, axis=1)

    def moved(self, by: Array) -> AxisModel:
        """Return it with its five numbers changed."""
        factor, offset, play, sine, cosine = (float(value) for value in by)
        return replace(
            self,
            factor=self.factor + factor,
            offset_rad=self.offset_rad + offset,
            play_rad=self.play_rad + play,
            sine_rad=self.sine_rad + sine,
            cosine_rad=self.cosine_rad + cosine,
        )


@dataclass(frozen=True, slots=True, eq=False)
class HeadModel:
    """A head with its camera; the axes are pan and tilt."""

    T_world_base: Transform
    T_arm_tilt: Transform
    T_mount_camera: Transform
    axes: tuple[AxisModel, AxisModel]

    def angles_rad(self, reported_rad: Array, travel: Array) -> Array:
        """Return (n, 2) angles of the optics from (n, 2) reports."""
        both = [axis.angle_rad(reported_rad[:, k], travel[:, k]) for k, axis in enumerate(self.axes)]
        return np.stack(both, axis=1)

    def T_world_camera(self, pan_rad: float, tilt_rad: float) -> Transform:
        """Return the camera's pose at angles of the optics."""
        return PanTilt(self.T_world_base, self.T_arm_tilt).T_world_camera(pan_rad, tilt_rad, self.T_mount_camera)


@dataclass(frozen=True, slots=True, eq=False)
class HeadViews:
    """m tags in n shots: of which ``shot`` and ``tag`` (m,) each is, its (m, 4, 3) corners in the tag's frame, its
    (m, 4, 2) ideal points and the lens's scale there, (m, 4, 2, 2) pixels per ideal.
    """

    shot: Indices
    tag: Indices
    corners_m: Array
    ideal: Array
    px_per_ideal: Array
    reported_rad: Array
    """(n, 2), as ``travel``."""
    travel: Array
    tags: tuple[str, ...]

    def only(self, kept: npt.NDArray[np.bool_]) -> HeadViews:
        """Return those of some views, all shots and tags staying."""
        return replace(
            self,
            shot=self.shot[kept],
            tag=self.tag[kept],
            corners_m=self.corners_m[kept],
            ideal=self.ideal[kept],
            px_per_ideal=self.px_per_ideal[kept],
        )


def views_of(shots: Sequence[HeadShot], lens: Lens, sizes_m: Mapping[str, float]) -> HeadViews:
    """Undistort all corners of the tags in ``sizes_m``; a tag past the lens's ``r_max`` is left out."""
    pairs = [(k, name, px) for k, shot in enumerate(shots) for name, px in shot.corners_px.items() if name in sizes_m]
    tags = tuple(sorted({name for _, name, _ in pairs}))
    pixels = np.stack([px for _, _, px in pairs]) if pairs else np.zeros((0, 4, 2))
    seen = observe_tags(lens, pixels)
    views = HeadViews(
        shot=np.array([k for k, _, _ in pairs], int),
        tag=np.array([tags.index(name) for _, name, _ in pairs], int),
        corners_m=np.array([sizes_m[name] * TAG_CORNERS for _, name, _ in pairs]).reshape(-1, 4, 3),
        ideal=seen.ideal,
        px_per_ideal=seen.px_per_ideal,
        reported_rad=np.array([shot.reported_rad for shot in shots]).reshape(-1, 2),
        travel=np.array([shot.travel for shot in shots], float).reshape(-1, 2),
        tags=tags,
    )
    return views.only(np.asarray(np.isfinite(seen.ideal).all(axis=(1, 2))))


def missed_px(model: HeadModel, T_world_tag: Array, views: HeadViews, off_rad: Array) -> tuple[Array, Array]:
    """Return by how many pixels (m, 8) the corners are missed, and the derivative (m, 8, 6, 6) by the errors
    (geometry.pose) of base, pan, arm, tilt, mount and tag; ``off_rad`` (n, 2) is added to the shots' angles.
    """
    n = len(views.reported_rad)
    angles_rad = model.angles_rad(views.reported_rad, views.travel) + off_rad
    pan = [transform(rotation_z(angle), np.zeros(3)) for angle in angles_rad[:, PAN]]
    tilt = [transform(rotation_y(-angle), np.zeros(3)) for angle in angles_rad[:, TILT]]
    T = np.stack([model.T_world_base, model.T_arm_tilt, model.T_mount_camera, *pan, *tilt, *T_world_tag])
    base, arm, mount = (np.full(len(views.shot), k) for k in range(3))
    camera = np.stack([base, 3 + views.shot, arm, 3 + n + views.shot, mount], axis=1)
    chains = Chains(camera, (3 + 2 * n + views.tag)[:, None])
    points, slopes = slopes_in_camera(T, chains, views.corners_m)
    depth = np.maximum(points[..., 2:], _NEAREST_M)
    ideal = points[..., :2] / depth
    by_point = np.zeros((*ideal.shape, 3))
    by_point[..., 0, 0] = by_point[..., 1, 1] = 1.0
    by_point[..., 2] = -ideal
    J = (views.px_per_ideal @ by_point / depth[..., None]) @ slopes.reshape(*points.shape, -1)
    residual = (views.px_per_ideal @ (ideal - views.ideal)[..., None])[..., 0]
    m = len(views.shot)
    return residual.reshape(m, 8), J.reshape(m, 8, 6, 6)


def moved(T: Transform, by: Array) -> Transform:
    """Return a pose moved by (6,) [d, r] in its own frame."""
    return np.asarray(T @ transform(rotation_exp(by[3:]), by[:3]))
