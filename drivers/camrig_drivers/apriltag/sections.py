"""The detector's section of the YAML, one model per backend: what each of them truly has."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from camrig.messages import TagDetection

DEFAULT_MARGIN = {"tag16h5": 30.0, "tagCircle21h7": 20.0}
"""Least decision margin where none is given. With no bit corrected, a random quadrangle is a tag16h5 once in 550,
a tagCircle21h7 once in 14,000, a tag of the other families once in 240,000 and rarer.
"""
OTHER_MARGIN = 10.0
"""For the other families; it drops tags whose black and white differ by less than 20 grey levels."""

C_FAMILIES = ("tag16h5", "tag25h9", "tag36h11", "tagCircle21h7", "tagStandard41h12")
HUGE_FAMILIES = ("tagCircle49h12", "tagCustom48h12", "tagStandard52h13")
"""The C library has them, but its table for correcting two bits (the wheels fix it at two) takes 3 GB and more."""

OPENCV_FAMILIES = ("tag16h5", "tag25h9", "tag36h10", "tag36h11")

DECIMATIONS = (1.0, 1.5, 2.0, 3.0, 4.0)
"""At any other value the C library shrinks the picture by one factor and scales the corners by another."""


def _decimation(value: float) -> float:
    if value not in DECIMATIONS:
        raise ValueError(f"must be one of {', '.join(f'{allowed:g}' for allowed in DECIMATIONS)}")
    return value


def _families(families: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    for family in families:
        if family in HUGE_FAMILIES and known is C_FAMILIES:
            raise ValueError(f"family {family} needs 3 GB and more for each detector; use one of {', '.join(known)}")
        if family not in known:
            raise ValueError(f"unknown family '{family}'; this detector has {', '.join(known)}")
    if len(set(families)) != len(families):
        raise ValueError("a family stands twice")
    return families


def _c_families(families: tuple[str, ...]) -> tuple[str, ...]:
    return _families(families, C_FAMILIES)


def _one_c_family(families: tuple[str, ...]) -> tuple[str, ...]:
    if len(families) != 1:
        raise ValueError("pupil-apriltags silently loads one family of several: give one, or use pyapriltags")
    return _families(families, C_FAMILIES)


def _opencv_families(families: tuple[str, ...]) -> tuple[str, ...]:
    return _families(families, OPENCV_FAMILIES)


Names = Annotated[tuple[str, ...], Field(min_length=1)]
Decimation = Annotated[float, AfterValidator(_decimation)]
Margin = Annotated[float, Field(ge=0.0, le=127.5)]


class DetectorSection(BaseModel):
    """What all backends share. ``decimate`` shrinks the picture in which tags are searched; corners and bits are
    always read in the full one. ``min_margin``: half the contrast of black and white, in grey levels.
    ``max_hamming``: how many wrong bits may be corrected; each one makes false tags likelier (tag16h5 in 76
    photographs without one: 1 with no bit corrected, margin 0.2; with one bit corrected margins up to 81).

    There is no switch for edge refinement: without it the C library's corners are shifted by an amount that
    depends on its version and on ``decimate`` (0.3 to 1.8 px measured on drawn tags).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    decimate: Decimation = 1.0
    min_margin: Margin | None = None
    max_hamming: Literal[0, 1, 2] = 0

    def counts(self, tag: TagDetection) -> bool:
        """Tell whether a tag was read well enough."""
        least = DEFAULT_MARGIN.get(tag.key.family, OTHER_MARGIN) if self.min_margin is None else self.min_margin
        return tag.hamming <= self.max_hamming and tag.margin >= least


class PyapriltagsSection(DetectorSection):
    """AprilTag 3.4 as pyapriltags packs it."""

    families: Annotated[Names, AfterValidator(_c_families)] = ("tag36h11",)


class PupilSection(DetectorSection):
    """AprilTag 3.1 as pupil-apriltags packs it."""

    families: Annotated[Names, AfterValidator(_one_c_family)] = ("tag36h11",)


class OpencvSection(DetectorSection):
    """OpenCV's detector. ``border_bits`` 2 reads Kalibr's AprilGrids, and only them."""

    families: Annotated[Names, AfterValidator(_opencv_families)] = ("tag36h11",)
    border_bits: Literal[1, 2] = 1
