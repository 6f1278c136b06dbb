"""The Kalman filter of one target, with the cameras' own errors carried along and never averaged away.

A fix's error is ``white + bias``: C, the part of the corner noise that is new in every fix, and what is the same for
many: L_s z_s for every source s, with unit normal z_s and the factor L_s. Sources are the cameras (their poses and
lenses) and the corner noise that repeats. The estimate's error is carried as the same two parts, of covariance W and
with sensitivities S_s; with D_s = L_s - H S_s, the part of z_s that a fix does not share with the estimate,

    K   = (W H^T - sum_s S_s D_s^T) (H W H^T + C + sum_s D_s D_s^T)^-1       (and some doubt: CHANGING)
    W   <- (I - K H) W (I - K H)^T + K C K^T          what noise and motion leave
    S_s <- S_s + K D_s                                how far the error of source s moves the estimate
    published = W + sum_s S_s S_s^T

which is exact for errors that stay and are independent between sources, however many fixes went in, and K the gain of
least variance (Schmidt-Kalman): what a fix and the estimate are both off by does not make the filter slow. All of this
once for a target that goes on calmly and once for one that swerves (fuse.modes, docs/decisions/0018).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from camrig.fuse.modes import Modes
from camrig.fuse.settings import MotionModel
from camrig.geometry.arrays import Array
from camrig.geometry.rotation import rotation_exp, rotation_log, rotation_z
from camrig.messages import Fix, Seen

CHANGING = 0.1
"""The part of what cameras add that gains count on as new in every fix, though it stays: heads and drones move, and an
error taken for quite the same would be solved for from how differently it shows in two fixes.
"""


_NO_TURN = 25.0
"""A heading more than five sigma from where it is expected was not reached by turning."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is known of one target at ``stamp_s``, the stamp of the last fix in it.

    ``modes`` is where it is and how fast, sensitive to ``sources`` (k); ``weighed`` (6, 6) is what the paper's
    weightings take for its covariance, None where fixes count as well as can be. When each camera last saw it, and
    with which of the paper's Q, is kept beside them. ``turning`` (2, 2) is the covariance of [heading,
    ``turn_rate_rad_s``], the rate at which its way turns with its heading (0 where its motion knows none).
    """

    stamp_s: float
    modes: Modes
    sources: tuple[str, ...]
    seen: tuple[Seen, ...]
    R_world_body: Array
    turn_rate_rad_s: float
    turning: Array
    weighed: Array | None

    @property
    def mean(self) -> Array:
        """[position, velocity] (6,)."""
        return self.modes.mean

    @property
    def published(self) -> Array:
        """The (6, 6) covariance the estimate is worth."""
        return self.modes.covariance


def begin(fix: Fix, model: MotionModel, weight: Array | None, repeating: float) -> Belief:
    """Start from one fix, at any velocity the motion allows; ``repeating`` is that part of its corner noise, ``weight``
    as in ``update``.
    """
    C, sources, factors = _parts(fix, repeating)
    white = np.zeros((6, 6))
    white[3:, 3:] = model.velocity_covariance
    weighed = None if weight is None else white + np.pad(fix.whole[:3, :3], (0, 3))
    white[:3, :3] = C
    sensitivity = np.concatenate([factors, np.zeros_like(factors)])
    mean = np.concatenate([fix.T_world_body[:3, 3], np.zeros(3)])
    n = len(model.often)
    return Belief(
        stamp_s=fix.stamp_s,
        modes=Modes(model.often, *(np.stack([part] * n) for part in (mean, white, sensitivity))),
        sources=sources,
        seen=fix.seen,
        R_world_body=fix.T_world_body[:3, :3],
        turn_rate_rad_s=0.0,
        turning=np.diag([_turn_variance(fix), model.turn_sigma_rad_s**2]),
        weighed=weighed,
    )


@lru_cache(maxsize=256)
def predict(belief: Belief, stamp_s: float, model: MotionModel) -> Belief:
    """Carry the belief on to ``stamp_s``, not before its own; same stamp, same belief. Remembered, for a frame's poses,
    motions and fixes ask for the same.
    """
    dt_s = stamp_s - belief.stamp_s
    if dt_s <= 0.0:
        return belief
    F, Q, becomes = model.step(dt_s)
    if model.turn_sigma_rad_s > 0.0:
        belief, F, Q = _along_an_arc(belief, F, Q, model, dt_s)
    turning = belief.turning.copy()
    turning[0, 0] += model.turn_rad2_s * dt_s
    weighed = belief.weighed
    return replace(
        belief,
        stamp_s=stamp_s,
        modes=belief.modes.carried_on(F, Q, becomes),
        weighed=None if weighed is None else F @ weighed @ F.T + np.tensordot(model.often, Q, axes=1),
        turning=turning,
    )


def _along_an_arc(belief: Belief, F: Array, Q: Array, model: MotionModel, dt_s: float) -> tuple[Belief, Array, Array]:
    """Return the belief with its heading and its rate carried on, and the transition and the noise of a velocity that
    turns meanwhile, what is uncertain of the rate included.

    The chord of an arc leads half the angle aside and is shorter by sin(a/2) / (a/2). More than a radian aside is no
    direction any more.
    """
    keep = math.exp(-dt_s / model.turn_memory_s)
    reach_s = model.turn_memory_s * (1.0 - keep)  # for so long the rate of now is the rate
    turned_rad = belief.turn_rate_rad_s * reach_s
    half, R_turned = 0.5 * turned_rad, rotation_z(turned_rad)
    F = F.copy()
    F[:3, 3:] = math.sin(half) / half * (rotation_z(half) @ F[:3, 3:]) if half else F[:3, 3:]
    F[3:, 3:] = R_turned @ F[3:, 3:]
    vx, vy, _ = belief.mean[3:]
    aside = np.array([-vy, vx, 0.0])
    aside_rad = min(math.sqrt(float(belief.turning[1, 1])) * reach_s, 1.0)
    by_rate = aside_rad * np.concatenate([0.5 * dt_s * aside, aside])
    A = np.array([[1.0, reach_s], [0.0, keep]])
    gained = model.turn_sigma_rad_s**2 * (1.0 - keep * keep)
    turning = A @ belief.turning @ A.T + gained * np.array([[reach_s**2 / 3.0, reach_s / 2.0], [reach_s / 2.0, 1.0]])
    carried_on = replace(
        belief,
        R_world_body=R_turned @ belief.R_world_body,
        turn_rate_rad_s=keep * belief.turn_rate_rad_s,
        turning=turning,
    )
    return carried_on, F, Q + np.outer(by_rate, by_rate)


def distances(belief: Belief, fix: Fix) -> tuple[float, list[float]]:
    """Return the squared Mahalanobis distance of a fix's position from a belief at its stamp, and from each mode."""
    modes = belief.modes
    means = np.concatenate([modes.mean[None], modes.means])[:, :3]
    covariances = np.concatenate([modes.covariance[None], modes.covariances])[:, :3, :3] + fix.whole[:3, :3]
    innovation = (fix.T_world_body[:3, 3] - means)[..., None]
    whole, *each = (innovation * np.linalg.solve(covariances, innovation)).sum(axis=(1, 2)).tolist()
    return whole, each


def update(belief: Belief, fix: Fix, weight: Array | None, repeating: float, *, suspect: bool = False) -> Belief:
    """Take in a fix at the belief's stamp, as well as can be or, where ``weight`` (3, 3) is given, as if that were the
    covariance of its error and nothing stayed the same; ``repeating`` as in ``begin``; ``suspect``: it may be wrong.
    """
    C, names, own = _parts(fix, repeating)
    sources = (*belief.sources, *(name for name in names if name not in belief.sources))
    factors = np.zeros((3, len(sources), own.shape[1] // len(names)))
    factors[:, [sources.index(name) for name in names]] = own.reshape(3, len(names), -1)
    factors = factors.reshape(3, -1)
    modes, place_m, weighed = belief.modes.knowing(factors.shape[1]), fix.T_world_body[:3, 3], belief.weighed
    if weight is None or weighed is None:
        modes = modes.taken(place_m, C, factors, CHANGING * (own @ own.T), suspect=suspect)
    else:
        K = np.asarray(np.linalg.solve(weighed[:3, :3] + weight, weighed[:3]).T, float)
        modes = modes.taken_by(K, place_m, C, factors)
        A = np.eye(6)
        A[:, :3] -= K
        weighed = A @ weighed @ A.T + K @ weight @ K.T
    R_world_body, turn_rate_rad_s, turning = _turned(belief, fix)
    return replace(
        belief,
        modes=modes,
        weighed=weighed,
        sources=sources,
        seen=_latest(belief.seen, fix.seen),
        R_world_body=R_world_body,
        turn_rate_rad_s=turn_rate_rad_s,
        turning=turning,
    )


def _parts(fix: Fix, repeating: float) -> tuple[Array, tuple[str, ...], Array]:
    """Return the white covariance (3, 3) of a fix's position, its k sources and their factors (3, 10 k), side by side.

    Corner noise that repeats is a source of its own: each camera's, and one of all that were estimated together.
    """
    corners, k, p = fix.covariance[:3, :3], len(fix.sources), fix.factors.shape[2]
    factors = np.zeros((3, k + 1, p))
    factors[:, :k] = fix.factors[:, :3].swapaxes(0, 1)
    factors[:, k, :3] = np.sqrt(repeating) * np.linalg.cholesky(corners)
    name = f"corners of {fix.seen[0].camera_id}" if len(fix.seen) == 1 else "corners"
    return (1.0 - repeating) * corners, (*fix.sources, name), factors.reshape(3, -1)


def _latest(before: tuple[Seen, ...], now: tuple[Seen, ...]) -> tuple[Seen, ...]:
    """Return the last time each camera saw the target."""
    last = {each.camera_id: each for each in before}
    for each in now:
        if each.camera_id not in last or each.stamp_s >= last[each.camera_id].stamp_s:
            last[each.camera_id] = each
    return tuple(last.values())


def _turn_variance(fix: Fix) -> float:
    """Return the variance of a fix's orientation: the mean of the axes', or the heading's where that is greater."""
    whole = fix.whole[3:, 3:]
    return max(float(np.trace(whole)) / 3.0, float(whole[2, 2]))


def _turned(belief: Belief, fix: Fix) -> tuple[Array, float, Array]:
    """Turn the believed orientation towards the seen one, by the weight of each, and the rate with it.

    A heading too far off to be a turn (a body that was picked up) is taken as it is, and says nothing of the rate.
    """
    P = belief.turning
    spread = float(P[0, 0]) + _turn_variance(fix)
    gain = P[:, 0] / spread
    apart = rotation_log(fix.T_world_body[:3, :3] @ belief.R_world_body.T)
    if apart[2] ** 2 > _NO_TURN * spread:
        turning = np.diag([_turn_variance(fix), float(P[1, 1])])
        return fix.T_world_body[:3, :3], belief.turn_rate_rad_s, turning
    R_world_body = np.asarray(rotation_exp(gain[0] * apart) @ belief.R_world_body)
    return R_world_body, belief.turn_rate_rad_s + float(gain[1] * apart[2]), P - spread * np.outer(gain, gain)
