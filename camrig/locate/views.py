"""What one frame shows, ready to be estimated together with the frames of other cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camrig.locate.lenses import Lenses
from camrig.locate.sightings import SeenBody
from camrig.locate.tags import SeenTag
from camrig.messages import CameraPose, Event, Fix, Seen, Sighting

SOURCE = 10
"""Numbers of a source of error (messages.Fix): six of a camera's pose, four of its lens."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One frame: the camera's pose by its carrier alone (None = nothing tells it) and after the anchors in view, the
    anchors that agree with it, the bodies, and where each body would be by this frame alone.
    """

    camera_id: str
    stamp_s: float
    carried: CameraPose | None
    found: CameraPose
    anchors: tuple[SeenTag, ...]
    bodies: tuple[SeenBody, ...]
    sightings: tuple[Sighting, ...]


@dataclass(frozen=True, slots=True)
class Together:
    """What frames of several cameras tell; ``lenses`` is None where nothing is learnt of them."""

    fixes: tuple[Fix, ...] = ()
    camera_poses: tuple[CameraPose, ...] = ()
    notes: tuple[Event, ...] = ()
    lenses: Lenses | None = None


def apart(views: Sequence[View]) -> Together:
    """Return what each camera saw as a fix of its own: the single-camera estimators, for comparison."""
    fixes = tuple(_single(sighting) for view in views for sighting in view.sightings)
    return Together(fixes, tuple({view.camera_id: view.found for view in views}.values()))


def _single(sighting: Sighting) -> Fix:
    factors = np.zeros((1, 6, SOURCE))
    factors[0, :, :6] = np.linalg.cholesky(sighting.camera_covariance)
    seen = Seen(sighting.camera_id, sighting.stamp_s, sighting.quality_m)
    return Fix(
        sighting.target_id,
        sighting.stamp_s,
        sighting.T_world_body,
        sighting.covariance,
        (sighting.camera_id,),
        factors,
        (seen,),
    )
