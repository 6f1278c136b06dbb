"""The inner loops of fits of poses, as machine code: they run for every tag of every frame."""

from __future__ import annotations

import math

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled

MIN_DEPTH_M = 1e-6
"""Behind the camera depth is clamped, which makes the residual huge: such a step is never taken."""

STEPS = 15
DONE = 1e-4
DONE_SHARE = 1e-3
"""A step that lowers chi2 by less than a hundredth of a sigma, or by less than a thousandth of what is left of it, ends
the refinement: the wrong one of two solutions creeps for ever.
"""


@compiled
def refine_stack(
    T: Array, points: Array, ideal: Array, whitener: Array, T_prior: Array, information: Array, H: Array, chi2: Array
) -> None:
    """Refine (m, 4, 4) poses in place, and fill their (m, 6, 6) normal matrices and (m,) sums of squares."""
    there, step, moved = np.zeros((6, 6)), np.zeros(6), np.zeros((4, 4))
    g, g_there = np.zeros(6), np.zeros(6)
    for k in range(len(T)):
        chi2[k] = _normal(T[k], points[k], ideal[k], whitener[k], T_prior[k], information[k], H[k], g)
        damping = 1e-6
        for _ in range(STEPS):
            there[:] = H[k]
            for i in range(6):
                there[i, i] *= 1.0 + damping
            step[:] = -np.linalg.solve(there, g)
            gain = -(step * g).sum()
            move(T[k], step, moved)
            chi2_there = _normal(moved, points[k], ideal[k], whitener[k], T_prior[k], information[k], there, g_there)
            if chi2_there <= chi2[k]:
                T[k], H[k], g[:], chi2[k] = moved, there, g_there, chi2_there
                damping *= 0.1
            else:
                damping = max(10.0 * damping, 1e-3)
            if gain < DONE + DONE_SHARE * chi2[k]:
                break


@compiled
def _normal(
    T: Array, points: Array, ideal: Array, whitener: Array, T_prior: Array, information: Array, H: Array, g: Array
) -> float:
    """Fill J^T J (6, 6) and J^T r (6,) of one pose, the prior included, and return r^T r."""
    H[:], g[:], total = 0.0, 0.0, 0.0
    slope = np.zeros((2, 6))
    for n in range(len(points)):
        x, y, z = (
            T[0, 0] * points[n, 0] + T[0, 1] * points[n, 1] + T[0, 2] * points[n, 2],
            T[1, 0] * points[n, 0] + T[1, 1] * points[n, 1] + T[1, 2] * points[n, 2],
            T[2, 0] * points[n, 0] + T[2, 1] * points[n, 1] + T[2, 2] * points[n, 2],
        )
        depth = max(z + T[2, 3], MIN_DEPTH_M)
        a, b = (x + T[0, 3]) / depth, (y + T[1, 3]) / depth
        # d (X/Z, Y/Z) with d X = dt + r x turned
        slope[0, 0], slope[0, 1], slope[0, 2] = 1.0, 0.0, -a
        slope[0, 3], slope[0, 4], slope[0, 5] = -a * y, z + a * x, -y
        slope[1, 0], slope[1, 1], slope[1, 2] = 0.0, 1.0, -b
        slope[1, 3], slope[1, 4], slope[1, 5] = -z - b * y, b * x, x
        for row in range(2):
            wa, wb = whitener[n, row, 0], whitener[n, row, 1]
            r = wa * (a - ideal[n, 0]) + wb * (b - ideal[n, 1])
            total += r * r
            for i in range(6):
                Ji = (wa * slope[0, i] + wb * slope[1, i]) / depth
                g[i] += Ji * r
                for j in range(i + 1):
                    H[i, j] += Ji * (wa * slope[0, j] + wb * slope[1, j]) / depth
    for i in range(6):
        for j in range(i):
            H[j, i] = H[i, j]
    return total + _prior(T, T_prior, information, H, g)


@compiled
def _prior(T: Array, T_prior: Array, information: Array, H: Array, g: Array) -> float:
    """Add what is known beforehand: error e = [t - t0, log(R R0^T)], G = d e / d pose to second order in the angle."""
    if not information.any():
        return 0.0
    R = np.ascontiguousarray(T[:3, :3]) @ np.ascontiguousarray(T_prior[:3, :3]).T
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sin2 = math.sqrt((v * v).sum())
    angle = math.atan2(sin2, R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    turn = v * (angle / sin2 if sin2 > 1e-9 else 0.5)
    K = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    e, G = np.zeros(6), np.eye(6)
    e[:3], e[3:] = T[:3, 3] - T_prior[:3, 3], turn
    G[3:, 3:] += -0.5 * K + K @ K / 12.0
    weighted = np.ascontiguousarray(information) @ e
    H += G.T @ np.ascontiguousarray(information) @ G
    g += G.T @ weighted
    return float((e * weighted).sum())


@compiled
def move_stack(T: Array, step: Array) -> Array:
    """Apply (m, 6) pose errors to (m, 4, 4) poses: geometry.pose.perturb for a stack."""
    moved = np.zeros(T.shape)
    for k in range(len(T)):
        move(T[k], step[k], moved[k])
    return moved


@compiled
def add_priors(T: Array, T_prior: Array, information: Array, H: Array, g: Array) -> float:
    """Add what is known of (m, 4, 4) poses beforehand to their (m, >= 6, >= 6) normal matrices and gradients."""
    total = 0.0
    for k in range(len(T)):
        total += _prior(T[k], T_prior[k], information[k], H[k, :6, :6], g[k, :6])
    return total


@compiled
def move(T: Array, step: Array, moved: Array) -> None:
    """Fill ``moved`` with a pose after a (6,) pose error (geometry.pose.perturb)."""
    x, y, z = step[3], step[4], step[5]
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(angle) / angle if angle > 1e-12 else 1.0
    c = (1.0 - math.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    moved[:] = T
    moved[:3, :3] = (np.eye(3) + s * K + c * (K @ K)) @ np.ascontiguousarray(T[:3, :3])
    moved[:3, 3] += step[:3]
