"""The quadratic programme: its answers satisfy the conditions of Karush, Kuhn and Tucker, and there is one or none."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from camrig.geometry.arrays import Array
from camrig.optimise.kernels.quadratic import cholesky, quadratic


def solve(hessian: Array, linear: Array, rows: Array, least: Array) -> tuple[bool, Array, Array]:
    lower, x, multipliers = np.empty_like(hessian), np.empty(len(linear)), np.empty(len(rows))
    assert cholesky(hessian, lower)
    np.testing.assert_allclose(lower @ lower.T, hessian, atol=1e-9 * np.abs(hessian).max())
    return bool(quadratic(lower, linear, rows, least, x, multipliers)), x, multipliers


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(1, 10), st.integers(0, 20), st.floats(0.0, 0.6))
def test_an_answer_is_optimal(seed: int, size: int, count: int, doubled: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    hessian, linear = root @ root.T + 1e-2 * np.eye(size), 3.0 * rng.normal(size=size)
    rows = rng.normal(size=(count, size))
    # Corners in which more constraints meet than there are variables, and the same one twice.
    for k in range(1, count):
        if rng.uniform() < doubled:
            rows[k] = rows[rng.integers(k)] * rng.choice([-1.0, 1.0])
    rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    least = rows @ rng.normal(size=size) - rng.choice([0.0, 0.2], size=count)
    found, x, multipliers = solve(hessian, linear, rows, least)
    assert found
    slack = rows @ x - least
    assert slack.min(initial=0.0) > -1e-8
    assert multipliers.min(initial=0.0) > -1e-9
    np.testing.assert_allclose(hessian @ x + linear - rows.T @ multipliers, 0.0, atol=1e-6)
    np.testing.assert_allclose(multipliers * slack, 0.0, atol=1e-6)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 10))
def test_it_finds_an_answer_just_where_there_is_one(seed: int, size: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, size))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    least = rng.normal(size=count)
    found, _, _ = solve(np.eye(size), np.zeros(size), rows, least)
    possible = linprog(np.zeros(size), A_ub=-rows, b_ub=-least, bounds=[(None, None)] * size)
    assert found == possible.success


def test_a_matrix_that_is_not_positive_definite_has_no_root() -> None:
    assert not cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]), np.empty((2, 2)))
    assert not cholesky(np.full((2, 2), np.nan), np.empty((2, 2)))
