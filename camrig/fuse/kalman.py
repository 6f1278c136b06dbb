"""The Kalman filter of one target, with the cameras' own errors carried along and never averaged away.

A sighting's error is ``white + bias``: C, the part of the corner noise that is new in every frame, and B, the same
for many frames of that camera: the part of the corner noise that repeats, and what the camera's pose adds. Gains K are
those of an ordinary filter with R = C + B. What the estimate is worth follows from these gains (a *consider*
covariance): with A = I - K H,

    W   <- A W A^T + K C K^T            what noise and motion leave
    S_c <- A S_c (+ K for camera c)     how far a bias of camera c moves the estimate
    published = W + sum_c S_c B_c S_c^T

which is exact for biases that stay and are independent between cameras, however many frames went in; B_c is the latest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from camrig.fuse.settings import MotionModel
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_exp, rotation_log
from camrig.messages import Sighting


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is known of one target at ``stamp_s``, the stamp of the last sighting in it.

    ``mean`` (6,) is [position, velocity]; ``covariance`` (6, 6) the one gains are computed from; ``white`` (6, 6),
    ``sensitivity`` (k, 6, 3) and ``bias`` (k, 3, 3) the parts of the published one, by ``cameras`` (k). The last
    stamp and the paper's Q of each camera's sightings are kept beside them.
    """

    stamp_s: float
    mean: Array
    covariance: Array
    white: Array
    sensitivity: Array
    bias: Array
    cameras: tuple[str, ...]
    stamps_s: tuple[float, ...]
    qualities_m: tuple[float, ...]
    R_world_body: Array
    turn_variance: float

    @property
    def published(self) -> Array:
        """The (6, 6) covariance the estimate is worth."""
        return np.asarray(self.white + (self.sensitivity @ self.bias @ self.sensitivity.swapaxes(1, 2)).sum(axis=0))


def begin(sighting: Sighting, model: MotionModel, repeating: float) -> Belief:
    """Start from one sighting, at any velocity the motion allows; ``repeating`` is that part of its corner noise."""
    C, B = _white_and_bias(sighting, repeating)
    covariance, white = np.zeros((6, 6)), np.zeros((6, 6))
    covariance[3:, 3:] = white[3:, 3:] = np.diag(np.square(model.velocity_sigma_m_s))
    covariance[:3, :3], white[:3, :3] = C + B, C
    return Belief(
        stamp_s=sighting.stamp_s,
        mean=np.concatenate([sighting.T_world_body[:3, 3], np.zeros(3)]),
        covariance=covariance,
        white=white,
        sensitivity=np.eye(6, 3)[None],
        bias=B[None],
        cameras=(sighting.camera_id,),
        stamps_s=(sighting.stamp_s,),
        qualities_m=(sighting.quality_m,),
        R_world_body=sighting.T_world_body[:3, :3],
        turn_variance=_turn_variance(sighting),
    )


def predict(belief: Belief, stamp_s: float, model: MotionModel) -> Belief:
    """Carry the belief on to ``stamp_s``, not before its own; same stamp, same belief."""
    dt_s = stamp_s - belief.stamp_s
    if dt_s <= 0.0:
        return belief
    F, Q = model.step(dt_s)
    return replace(
        belief,
        stamp_s=stamp_s,
        mean=F @ belief.mean,
        covariance=F @ belief.covariance @ F.T + Q,
        white=F @ belief.white @ F.T + Q,
        sensitivity=F @ belief.sensitivity,
        turn_variance=belief.turn_variance + model.turn_rad2_s * dt_s,
    )


def distance(belief: Belief, sighting: Sighting) -> float:
    """Return the squared Mahalanobis distance of a sighting's position from a belief at its stamp."""
    innovation = sighting.T_world_body[:3, 3] - belief.mean[:3]
    S = belief.published[:3, :3] + sighting.covariance[:3, :3] + sighting.camera_covariance[:3, :3]
    return float(innovation @ np.linalg.solve(S, innovation))


def update(belief: Belief, sighting: Sighting, R: Array, repeating: float) -> Belief:
    """Take in a sighting at the belief's stamp; weighed by ``R`` (3, 3); ``repeating`` as in ``begin``."""
    C, B = _white_and_bias(sighting, repeating)
    PHt = belief.covariance[:, :3]
    K = np.linalg.solve(PHt[:3] + R, PHt.T).T
    A = np.eye(6)
    A[:, :3] -= K
    cameras, at = _with_camera(belief, sighting.camera_id)
    known = len(belief.cameras)
    sensitivity, bias = np.zeros((len(cameras), 6, 3)), np.zeros((len(cameras), 3, 3))
    sensitivity[:known], bias[:known] = A @ belief.sensitivity, belief.bias
    sensitivity[at] += K
    bias[at] = B
    R_world_body, turn_variance = _turned(belief, sighting)
    return replace(
        belief,
        mean=belief.mean + K @ (sighting.T_world_body[:3, 3] - belief.mean[:3]),
        covariance=A @ belief.covariance @ A.T + K @ R @ K.T,
        white=A @ belief.white @ A.T + K @ C @ K.T,
        sensitivity=sensitivity,
        bias=bias,
        cameras=cameras,
        stamps_s=_put(belief.stamps_s, at, sighting.stamp_s),
        qualities_m=_put(belief.qualities_m, at, sighting.quality_m),
        R_world_body=R_world_body,
        turn_variance=turn_variance,
    )


def _white_and_bias(sighting: Sighting, repeating: float) -> tuple[Array, Array]:
    corners = sighting.covariance[:3, :3]
    return (1.0 - repeating) * corners, sighting.camera_covariance[:3, :3] + repeating * corners


def _with_camera(belief: Belief, camera_id: str) -> tuple[tuple[str, ...], int]:
    """Return the cameras with this one among them, and its place."""
    if camera_id in belief.cameras:
        return belief.cameras, belief.cameras.index(camera_id)
    return (*belief.cameras, camera_id), len(belief.cameras)


def _put(values: tuple[float, ...], at: int, value: float) -> tuple[float, ...]:
    return (*values[:at], value, *values[at + 1 :])


def _turn_variance(sighting: Sighting) -> float:
    return float(np.trace(sighting.covariance[3:, 3:] + sighting.camera_covariance[3:, 3:])) / 3.0


def _turned(belief: Belief, sighting: Sighting) -> tuple[Array, float]:
    """Turn the believed orientation towards the seen one, by the weight of each."""
    gain = belief.turn_variance / (belief.turn_variance + _turn_variance(sighting))
    apart = rotation_log(sighting.T_world_body[:3, :3] @ belief.R_world_body.T)
    return np.asarray(rotation_exp(gain * apart) @ belief.R_world_body), (1.0 - gain) * belief.turn_variance
