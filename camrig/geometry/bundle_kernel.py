"""The inner loop of ``geometry.bundle``, as machine code: every tag of every camera, linearised and added up."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from camrig.geometry.arrays import Array
from camrig.geometry.jit import compiled
from camrig.geometry.pnp_kernel import MIN_DEPTH_M

CAMERA = 10
"""Unknowns of a camera: [dx dy dz rx ry rz] of its pose, then its lens's four."""

HUBER_CHI2 = 20.1
"""chi2 of the 8 numbers of one tag that noise exceeds once in 100: beyond it a tag counts in proportion to its root."""

Indices = npt.NDArray[np.int64]


@compiled
def accumulate(
    T_world_camera: Array,
    lens: Array,
    T_world_body: Array,
    camera: Indices,
    body: Indices,
    corners: Array,
    shift: Array,
    spread: Array,
    turn: Array,
    slack: Array,
    ideal: Array,
    whitener: Array,
    lens_slopes: Array,
    Hcc: Array,
    Hbc: Array,
    Hbb: Array,
    gc: Array,
    gb: Array,
    chi2: Array,
) -> float:
    """Add every view's J^T J and J^T r to the normal equations; return the robust cost."""
    cost = 0.0
    J, r = np.zeros((8, 16)), np.zeros(8)
    for v in range(len(camera)):
        c, b = camera[v], body[v]
        _linearise(
            T_world_camera[c], lens[c], T_world_body[b] if b >= 0 else np.eye(4), b >= 0,
            corners[v], shift[v], turn[v], slack[v], ideal[v], whitener[v], lens_slopes[v], J, r,
        )  # fmt: skip
        H, g = J.T @ J, J.T @ r
        square = (r * r).sum()
        if b >= 0:
            square = _marginalised(H, g, square, spread[v])
        chi2[v] = square
        weight = 1.0
        if square > HUBER_CHI2:
            weight = math.sqrt(HUBER_CHI2 / square)
            cost += 2.0 * math.sqrt(HUBER_CHI2 * square) - HUBER_CHI2
        else:
            cost += square
        Hcc[c] += weight * H[:CAMERA, :CAMERA]
        gc[c] += weight * g[:CAMERA]
        if b >= 0:
            Hbb[b] += weight * H[CAMERA:, CAMERA:]
            Hbc[b, :, CAMERA * c : CAMERA * (c + 1)] += weight * H[CAMERA:, :CAMERA]
            gb[b] += weight * g[CAMERA:]
    return cost


@compiled
def _linearise(
    T_world_camera: Array,
    lens: Array,
    T_world_body: Array,
    moves: bool,
    corners: Array,
    shift: Array,
    turn: Array,
    slack: Array,
    ideal: Array,
    whitener: Array,
    lens_slopes: Array,
    J: Array,
    r: Array,
) -> None:
    """Fill the (8,) whitened residuals of one tag and their (8, 16) derivative by its camera, lens and body.

    A body that turned between two views is linearised in each where it is seen there: to the first order alone, a turn
    by 5 degrees shrinks a tag by 0.4 %, as if it were a centimetre further.
    """
    by_camera, R = np.zeros((3, 16)), T_world_camera[:3, :3].T
    R_body = np.ascontiguousarray(turn) @ np.ascontiguousarray(T_world_body[:3, :3])
    turned, away, point = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(4):
        for i in range(3):
            turned[i] = 0.0
            for j in range(3):
                turned[i] += R_body[i, j] * corners[k, j]
            away[i] = turned[i] + T_world_body[i, 3] + shift[i] - T_world_camera[i, 3]
        for i in range(3):
            point[i] = R[i, 0] * away[0] + R[i, 1] * away[1] + R[i, 2] * away[2]
        depth = max(point[2], MIN_DEPTH_M)
        x, y = point[0] / depth, point[1] / depth
        for i in range(3):
            # d point = R (d_b + r_b x turned - d_c - r_c x away)
            for j in range(3):
                by_camera[i, j] = -R[i, j]
                by_camera[i, 10 + j] = R[i, j] if moves else 0.0
            by_camera[i, 3] = R[i, 1] * -away[2] + R[i, 2] * away[1]
            by_camera[i, 4] = R[i, 0] * away[2] - R[i, 2] * away[0]
            by_camera[i, 5] = R[i, 1] * away[0] - R[i, 0] * away[1]
            for j in range(3):
                by_camera[i, 3 + j] *= -1.0
            if moves:
                by_camera[i, 13] = R[i, 1] * -turned[2] + R[i, 2] * turned[1]
                by_camera[i, 14] = R[i, 0] * turned[2] - R[i, 2] * turned[0]
                by_camera[i, 15] = R[i, 1] * turned[0] - R[i, 0] * turned[1]
            else:
                by_camera[i, 13] = by_camera[i, 14] = by_camera[i, 15] = 0.0
        for row in range(2):
            wx, wy = whitener[k, row, 0], whitener[k, row, 1]
            r[2 * k + row] = wx * (x - ideal[k, 0]) + wy * (y - ideal[k, 1])
            for j in range(16):
                dx = (by_camera[0, j] - x * by_camera[2, j]) / depth
                dy = (by_camera[1, j] - y * by_camera[2, j]) / depth
                J[2 * k + row, j] = wx * dx + wy * dy
            for j in range(4):
                J[2 * k + row, 6 + j] = lens_slopes[k, row, j]
                r[2 * k + row] += lens_slopes[k, row, j] * lens[j]
    by_turn = np.ascontiguousarray(J[:, 13:])  # what is added to the turn; the body's own rotation comes before it
    r += by_turn @ slack
    J[:, 13:] = by_turn @ np.ascontiguousarray(turn)


@compiled
def _marginalised(H: Array, g: Array, square: float, spread: Array) -> float:
    """Let the body's pose be another at this view's stamp, by N(0, spread): H, g in place; return the sum of squares.

    With p the body and N = (I + spread Hpp)^-1 spread: H - H_.p N H_p., g - H_.p N g_p, r^T r - g_p^T N g_p.
    """
    if np.trace(spread) <= 0.0:
        return square
    p = np.ascontiguousarray(H[CAMERA:, :])
    gp = g[CAMERA:].copy()
    N = np.linalg.solve(np.eye(6) + spread @ np.ascontiguousarray(H[CAMERA:, CAMERA:]), spread)
    pN = p.T @ N
    H -= pN @ p
    g -= pN @ gp
    return float(square - gp @ (N @ gp))
