"""The smooth problem of ``kernels.smoothed`` once more, as a CasADi graph: IPOPT has its exact Hessian from it. Pure.

Heads, drones and zooms, Brown-Conrady lenses, and the qualities of a point.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.lens.brown import brown_sensor, brown_slopes
from camrig.geometry.lens_row import ALPHA, COEFFICIENTS, CX, CY, FX, FY, HEIGHT, R_MAX, WIDTH
from camrig.optimise.comparators.common import free_variables
from camrig.optimise.kernels.problem import (
    ARM_R,
    ARM_T,
    BASE_R,
    CAMERA_R,
    CAMERA_T,
    LENS_COUNT,
    LENS_FIRST,
    MARGIN,
    PAN,
    PIXEL,
    POINT,
    REACH,
    ROOM,
    TAGGED,
    TILT,
    ZOOM,
    Problem,
    Z,
)
from camrig.optimise.kernels.sight import NEAR_M
from camrig.optimise.kernels.smoothed import AXIS_M2

Symbol = Any
"""A CasADi expression, or a number that stands for one."""


class Graph(NamedTuple):
    """Symbols: the joint free variables (size,), the sharpness, the unseen target's quality; and what follows of them.

    ``quality_m`` and ``view`` (log sum V) are lists with an expression for each target.
    """

    variables: Symbol
    sharpness: Symbol
    unseen_m: Symbol
    quality_m: list[Symbol]
    view: list[Symbol]


class _View(NamedTuple):
    """A camera: R_world_camera (3, 3), its place (3,), its lens's row."""

    R: Symbol
    origin: Symbol
    lens: list[Symbol]


def graph_of(casadi: ModuleType, problem: Problem, start: Array) -> Graph:
    """Return the graph; what is not free is as in the vectors (n, 6) of ``start``."""
    free = free_variables(problem)
    variables = casadi.SX.sym("x", int(free.sum()))
    sharpness, unseen_m = casadi.SX.sym("sharpness"), casadi.SX.sym("unseen_m")
    vectors: list[list[Symbol]] = start.tolist()
    for k, (i, variable) in enumerate(zip(*np.nonzero(free), strict=True)):
        vectors[i][variable] = variables[k]
    views = [_view(casadi, problem, i, u) for i, u in enumerate(vectors)]
    quality_m, view = [], []
    for target in problem.targets:
        logs = [_log_view(casadi, problem, each, target, sharpness) for each in views]
        gains = [_gain(casadi, problem, each, target) for each in views]
        seen = sum(casadi.exp(log) * gain for log, gain in zip(logs, gains, strict=True))
        quality_m.append(1.0 / (1.0 / unseen_m + seen))
        view.append(_log_sum(casadi, logs))
    return Graph(variables, sharpness, unseen_m, quality_m, view)


def _view(casadi: ModuleType, problem: Problem, i: int, u: list[Symbol]) -> _View:
    """Return the pose as ``kernels.pose.pose_of`` and the lens as ``lens_of`` have it."""
    row = problem.cameras[i]
    base, arm, mount = (casadi.DM(row[at : at + 9].reshape(3, 3)) for at in (BASE_R, ARM_R, CAMERA_R))
    c, s = casadi.cos(u[PAN]), casadi.sin(u[PAN])
    R_arm = base @ _matrix(casadi, [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = casadi.cos(u[TILT]), casadi.sin(u[TILT])
    R_mount = R_arm @ arm @ _matrix(casadi, [[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    origin = casadi.vertcat(*u[: Z + 1])
    origin += R_arm @ casadi.DM(row[ARM_T : ARM_T + 3]) + R_mount @ casadi.DM(row[CAMERA_T : CAMERA_T + 3])
    return _View(R_mount @ mount, origin, _lens(casadi, problem, i, u[ZOOM]))


def _matrix(casadi: ModuleType, rows: list[list[Symbol]]) -> Symbol:
    return casadi.vertcat(*(casadi.horzcat(*row) for row in rows))


def _lens(casadi: ModuleType, problem: Problem, i: int, zoom: Symbol) -> list[Symbol]:
    """Return the row of the lens at a zoom: every row of the table counts with a hat of width 1 about it."""
    first, count = (int(problem.cameras[i, at]) for at in (LENS_FIRST, LENS_COUNT))
    rows = problem.lenses[first : first + count]
    if count == 1:
        return [float(value) for value in rows[0]]
    hats = [casadi.fmax(0.0, 1.0 - casadi.fabs(zoom - k)) for k in range(count)]
    lens = [sum(hat * float(value) for hat, value in zip(hats, column, strict=True)) for column in rows.T]
    lens[ALPHA] = casadi.atan(lens[WIDTH] / (2.0 * casadi.sqrt(lens[FX] * lens[FY])))
    return lens


def _to_camera(casadi: ModuleType, view: _View, point: Array) -> tuple[Symbol, Symbol, Symbol]:
    inside = view.R.T @ (casadi.DM(point) - view.origin)
    return inside[0], inside[1], inside[2]


def _depth(casadi: ModuleType, lens: list[Symbol], x: Symbol, y: Symbol, z: Symbol) -> Symbol:
    return casadi.fmax(casadi.fmax(z, casadi.sqrt(x * x + y * y + AXIS_M2) / lens[R_MAX]), NEAR_M)


def _gain(casadi: ModuleType, problem: Problem, view: _View, target: Array) -> Symbol:
    """Return 1/Q as ``sensing.point`` has it."""
    lens = view.lens
    x, y, z = _to_camera(casadi, view, target[POINT : POINT + 3])
    z = _depth(casadi, lens, x, y, z)
    focal_px = casadi.sqrt(lens[FX] * lens[FY])
    if problem.quality != PIXEL:
        return focal_px * z / (x * x + y * y + z * z)
    ua, ub, va, vb = brown_slopes(lens[COEFFICIENTS:], x / z, y / z)
    det = ua * vb - ub * va
    return focal_px * det * det / (z * ua * vb)


def _log_view(casadi: ModuleType, problem: Problem, view: _View, target: Array, sharpness: Symbol) -> Symbol:
    """Return log V."""
    lens, margin_rad = view.lens, float(problem.settings[MARGIN])
    holds = casadi.atan(lens[R_MAX]) - margin_rad
    x, y, z = _to_camera(casadi, view, target[POINT : POINT + 3])
    distance = casadi.sqrt(x * x + y * y + z * z + AXIS_M2)
    if problem.cone:
        widened = casadi.atan(float(target[REACH]) / _depth(casadi, lens, x, y, z))
        half = casadi.fmin(lens[ALPHA] - margin_rad, holds) - widened
        return -_log_sum(casadi, [0.0, -sharpness * (z / distance - casadi.cos(half))])
    terms = [0.0, -sharpness * (z / distance - casadi.cos(holds))]
    whole = target[TAGGED] > 0.0
    for at in range(ROOM, ROOM + 12, 3) if whole else (POINT,):
        edges = _edges(casadi, lens, _to_camera(casadi, view, target[at : at + 3]), margin_rad)
        terms += [-sharpness * inside / lens[WIDTH] for inside in edges]
    return -_log_sum(casadi, terms)


def _edges(
    casadi: ModuleType, lens: list[Symbol], point: tuple[Symbol, Symbol, Symbol], margin_rad: float
) -> list[Symbol]:
    """Return the pixels that a point is inside the picture's four edges, as ``sensing.view.image_clearance`` has it."""
    x, y, z = point
    z = _depth(casadi, lens, x, y, z)
    a, b = x / z, y / z
    u, v = brown_sensor(lens[COEFFICIENTS:], a, b)
    across, down = lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
    ua, ub, va, vb = brown_slopes(lens[COEFFICIENTS:], a, b)
    stretch = 1.0 + a * a + b * b
    inset_x = margin_rad * lens[FX] * casadi.sqrt(stretch * (ua * ua + ub * ub + (ua * a + ub * b) ** 2))
    inset_y = margin_rad * lens[FY] * casadi.sqrt(stretch * (va * va + vb * vb + (va * a + vb * b) ** 2))
    return [across - inset_x, lens[WIDTH] - across - inset_x, down - inset_y, lens[HEIGHT] - down - inset_y]


def _log_sum(casadi: ModuleType, terms: list[Symbol]) -> Symbol:
    """Return the logarithm of the sum of exponentials, the largest taken out lest they overflow."""
    highest = terms[0]
    for term in terms[1:]:
        highest = casadi.fmax(highest, term)
    return highest + casadi.log(sum(casadi.exp(term - highest) for term in terms))
