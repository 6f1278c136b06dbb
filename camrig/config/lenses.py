"""Lenses in YAML: of one focal length, or with a table of their zoom."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from camrig.config.document import StrictModel
from camrig.errors import InputError
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.lens.pinhole import one_to_one_radius

Focal = Annotated[float, Field(gt=0.0, le=100_000.0)]
Pixels = Annotated[int, Field(ge=16, le=20_000)]
Radius = Annotated[float, Field(gt=0.0, le=50.0)]
Readout = Annotated[float, Field(ge=0.0, le=1.0)]
LensKind = Literal["brown", "fisheye"]


class LensModel(StrictModel):
    """A lens: OpenCV's coefficients in OpenCV's order, pixels of the full picture."""

    model: LensKind = "brown"
    size_px: tuple[Pixels, Pixels]
    fx: Focal
    fy: Focal
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    r_max: Radius | None = None
    readout_s: Readout = 0.0

    @model_validator(mode="after")
    def _buildable(self) -> LensModel:
        try:
            lens = self.build()
        except InputError as error:
            raise ValueError(str(error)) from error
        if self.r_max is not None and (radius := one_to_one_radius(lens, self.r_max)) < self.r_max:
            raise ValueError(f"r_max {self.r_max:g} is past {radius:.3f}, where this lens stops being one-to-one")
        if not (0.0 < self.cx < self.size_px[0] and 0.0 < self.cy < self.size_px[1]):
            raise ValueError(f"cx, cy ({self.cx:g}, {self.cy:g}) must lie inside the picture of size_px {self.size_px}")
        return self

    def build(self) -> BrownLens | FisheyeLens:
        """Return the lens of geometry; raises InputError for a wrong number of coefficients."""
        geometry = (self.size_px, (self.fx, self.fy), (self.cx, self.cy))
        lens: BrownLens | FisheyeLens
        if self.model == "fisheye":
            lens = FisheyeLens(*geometry, self.distortion or (0.0, 0.0, 0.0, 0.0))
        else:
            lens = BrownLens(*geometry, self.distortion)
        return lens if self.r_max is None else replace(lens, r_max=self.r_max)


class ZoomRowModel(StrictModel):
    """The lens at one position of its zoom; without cx, cy its centre is the picture's."""

    position: Annotated[float, Field(ge=-1e6, le=1e6)]
    fx: Focal
    fy: Focal
    cx: float | None = None
    cy: float | None = None
    distortion: tuple[float, ...] = ()
    r_max: Radius | None = None


class ZoomLensModel(StrictModel):
    """A lens that zooms: a table by position; between two rows everything goes linearly."""

    model: LensKind = "brown"
    size_px: tuple[Pixels, Pixels]
    zoom: Annotated[tuple[ZoomRowModel, ...], Field(min_length=2)]
    readout_s: Readout = 0.0

    @model_validator(mode="after")
    def _buildable(self) -> ZoomLensModel:
        positions = [row.position for row in self.zoom]
        if any(before >= after for before, after in pairwise(positions)):
            listed = ", ".join(f"{position:g}" for position in positions)
            raise ValueError(f"the positions of zoom must rise from row to row, not go {listed}")
        for index, row in enumerate(self.zoom):
            try:
                self._row(row)
            except ValidationError as error:
                message = error.errors()[0]["msg"].removeprefix("Value error, ")
                raise ValueError(f"zoom[{index}]: {message}") from error
        return self

    def build(self) -> tuple[tuple[float, BrownLens | FisheyeLens], ...]:
        """Return every position with the lens there."""
        return tuple((row.position, self._row(row).build()) for row in self.zoom)

    def _row(self, row: ZoomRowModel) -> LensModel:
        width, height = self.size_px
        centre = {"cx": width / 2.0, "cy": height / 2.0}
        given = {key: value for key, value in row.model_dump(exclude={"position"}).items() if value is not None}
        return LensModel.model_validate({"model": self.model, "size_px": self.size_px, **centre, **given})


AnyLensModel = LensModel | ZoomLensModel


def lens_model(data: object) -> type[LensModel] | type[ZoomLensModel]:
    """Return the model by which a lens's section is checked."""
    return ZoomLensModel if isinstance(data, dict) and "zoom" in data else LensModel
