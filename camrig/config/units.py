"""Small checked types of the YAML language, and their conversion to SI."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from camrig.config.document import StrictModel
from camrig.geometry.arrays import Transform
from camrig.geometry.pose import transform
from camrig.geometry.rotation import rotation_from_rpy
from camrig.rig import Interval

Metres = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Point = tuple[Metres, Metres, Metres]
PointXY = tuple[Metres, Metres]


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] >= limits[1]:
        raise ValueError(f"the first limit must be below the second, not {limits[0]:g} and {limits[1]:g}")
    return limits


def _not_empty(box: tuple[Point, Point]) -> tuple[Point, Point]:
    if any(low >= high for low, high in zip(*box, strict=True)):
        raise ValueError("the box is empty: its first corner must be below its second in x, y and z")
    return box


def _area(corners: tuple[PointXY, PointXY]) -> tuple[PointXY, PointXY]:
    if any(low >= high for low, high in zip(*corners, strict=True)):
        raise ValueError("the floor is empty: its first corner must be below its second in x and y")
    return corners


def _surface(box: tuple[Point, Point]) -> tuple[Point, Point]:
    if any(low > high for low, high in zip(*box, strict=True)) or box[0] == box[1]:
        raise ValueError(
            "the surface is empty: its first corner must not be above its second in x, y or z, nor equal it"
        )
    return box


def _yaw(given: object, handler: ValidatorFunctionWrapHandler) -> object:
    try:
        return handler(given)
    except ValidationError as error:
        raise ValueError(
            "must be one angle from -360 to 360, or [lowest, highest] of those plans choose from"
        ) from error


LimitsDeg = Annotated[tuple[Degrees, Degrees], AfterValidator(_ascending)]
YawDeg = Annotated[Degrees | LimitsDeg, WrapValidator(_yaw)]
BoxM = Annotated[tuple[Point, Point], AfterValidator(_not_empty)]
SurfaceM = Annotated[tuple[Point, Point], AfterValidator(_surface)]
FloorM = Annotated[tuple[PointXY, PointXY], AfterValidator(_area)]


class PoseModel(StrictModel):
    """A rigid pose as people write it: position in metres, roll-pitch-yaw about fixed axes in degrees."""

    position_m: Point = (0.0, 0.0, 0.0)
    rpy_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)

    def build(self) -> Transform:
        """Return the (4, 4) transform."""
        return transform(rotation_from_rpy(*(math.radians(angle) for angle in self.rpy_deg)), np.array(self.position_m))


def radians(limits_deg: tuple[float, float]) -> Interval:
    """Convert a pair of limits from degrees."""
    return math.radians(limits_deg[0]), math.radians(limits_deg[1])
