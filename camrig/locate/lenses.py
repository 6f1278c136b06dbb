"""What is known of the rig's lenses and of where they are: calibrations, and what was learnt of both in service."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from camrig.geometry.arrays import Array
from camrig.geometry.bundle import LensPriors
from camrig.geometry.pose import perturb
from camrig.locate.standing import Standing
from camrig.messages import CameraPose
from camrig.rig import CameraSpec, Rig, TagKey

LEAST_SHARE = 0.1
"""So much of a calibration's sigma always stays: what a few numbers cannot say of a lens, or of what carries it."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A lens's errors (geometry.lens.errors): (4,) mean and (4, 4) covariance, and whether a bound holds the mean."""

    mean: Array
    covariance: Array
    bounded: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Lenses:
    """What was learnt of the rig's lenses, and with them of their cameras' poses, since the start.

    ``standing`` is all that is known of what stays wrong, ``refined`` its part for the lenses that are to be refined;
    ``counted`` is where (2,) px each tag was when it last counted in a camera's picture, ``told`` what an operator
    knows.
    """

    stamp_s: float = -math.inf
    standing: Standing | None = None
    refined: Mapping[str, Refined] = field(default_factory=dict)
    counted: Mapping[tuple[str, TagKey], Array] = field(default_factory=dict)
    told: Mapping[str, Refined] = field(default_factory=dict)

    def priors(self, cameras: Sequence[CameraSpec]) -> LensPriors:
        """Return what is known of these cameras' lenses: as calibrated, or as refined where that is wanted."""
        known = [self.refined.get(camera.id) or as_calibrated(camera) for camera in cameras]
        information = np.linalg.inv(np.stack([each.covariance for each in known]))
        return LensPriors(np.stack([each.mean for each in known]), np.asarray(information, float))

    def pose(self, carried: CameraPose, rig: Rig) -> CameraPose:
        """Return a camera's pose by its carrier, or as frames before have shown it where that is better known in every
        respect and the carrier has not moved since.
        """
        found = self.standing.pose(rig, carried.camera_id, carried.T_world_camera) if self.standing else None
        if found is None:
            return carried
        error, covariance = found
        covariance = covariance + LEAST_SHARE**2 * carried.covariance
        if np.linalg.eigvalsh(carried.covariance - covariance)[0] < 0.0:
            return carried
        T_world_camera = perturb(carried.T_world_camera, error)
        return replace(carried, T_world_camera=T_world_camera, covariance=covariance)


AS_CALIBRATED = Lenses()
"""Nothing was learnt yet."""


def as_calibrated(camera: CameraSpec) -> Refined:
    """Return what the calibration says: no error, but for what it left wrong."""
    return Refined(np.zeros(4), np.diag(np.square(camera.lens_sigma)))
