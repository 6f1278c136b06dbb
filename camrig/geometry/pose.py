"""Rigid transforms as (4, 4) matrices, and the one convention for their uncertainty.

A pose's covariance is (6, 6) over ``[dx dy dz rx ry rz]``, both halves about the axes of the *target*
frame (the first in the name): ``t_true = t + d``, ``R_true = exp(r) R``. This is ROS's convention too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camrig.geometry.arrays import Array, Transform
from camrig.geometry.rotation import rotation_exp, rotation_log, skew

_EYE = np.eye(4)


@dataclass(frozen=True, slots=True, eq=False)
class PosePriors:
    """What is known of (k, 4, 4) poses beforehand: their (k, 6, 6) information (inverse covariance; zero = nothing)."""

    T: Array
    information: Array


def transform(R: Array, t: Array) -> Transform:
    """Build the (4, 4) transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = _EYE.copy()
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def invert(T: Transform) -> Transform:
    """Return the inverse of a rigid transform: ``T_b_a`` from ``T_a_b``."""
    R = T[:3, :3]
    return transform(R.T, -R.T @ T[:3, 3])


def apply(T_a_b: Transform, points_b: Array) -> Array:
    """Map (..., 3) points from frame b into frame a."""
    return np.asarray(points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3])


def perturb(T: Transform, delta: Array) -> Transform:
    """Apply a (6,) error ``[d, r]`` in this module's convention."""
    return transform(rotation_exp(delta[3:]) @ T[:3, :3], T[:3, 3] + delta[:3])


def difference(T_true: Transform, T: Transform) -> Array:
    """Return the (6,) error ``[d, r]`` that ``perturb`` would need to turn ``T`` into ``T_true``."""
    return np.concatenate([T_true[:3, 3] - T[:3, 3], rotation_log(T_true[:3, :3] @ T[:3, :3].T)])


def compose(
    T_a_b: Transform, covariance_a_b: Array, T_b_c: Transform, covariance_b_c: Array
) -> tuple[Transform, Array]:
    """Chain two uncertain, independent poses; returns ``T_a_c`` and its (6, 6) covariance (first order)."""
    R = T_a_b[:3, :3]
    J_ab = np.eye(6)
    J_ab[:3, 3:] = -skew(R @ T_b_c[:3, 3])
    J_bc = np.zeros((6, 6))
    J_bc[:3, :3] = R
    J_bc[3:, 3:] = R
    covariance = J_ab @ covariance_a_b @ J_ab.T + J_bc @ covariance_b_c @ J_bc.T
    return T_a_b @ T_b_c, covariance


def inverse_covariance_pose(T_a_b: Transform, covariance_a_b: Array) -> tuple[Transform, Array]:
    """Invert an uncertain pose; returns ``T_b_a`` and its (6, 6) covariance (first order)."""
    T_b_a = invert(T_a_b)
    R = T_b_a[:3, :3]
    J = np.zeros((6, 6))
    J[:3, :3] = -R
    J[:3, 3:] = -R @ skew(T_a_b[:3, 3])
    J[3:, 3:] = -R
    return T_b_a, J @ covariance_a_b @ J.T
