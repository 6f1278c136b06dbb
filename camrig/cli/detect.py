"""``camrig detect``: tags in pictures and videos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import ValidationError
from rich.markup import escape
from rich.table import Table

from camrig import pictures
from camrig.cli.console import print_json, progress_bar, results
from camrig.cli.refinement import load_refinement
from camrig.cli.tag_pose import TagPose, tag_pose
from camrig.clock import RealClock
from camrig.config.document import load_document
from camrig.config.lenses import LensModel
from camrig.detect import detect_tags
from camrig.errors import ConfigError, InputError, PartialError
from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.lens import Lens
from camrig.geometry.pose import apply
from camrig.interfaces import TagDetector
from camrig.messages import Frame, TagDetection, TagDetections
from camrig.pictures import Picture
from camrig.plugins import load_plugin
from camrig.report.tag_picture import ColourImage, draw_tags, write_picture


@dataclass(frozen=True, slots=True, eq=False)
class _Ruler:
    """A lens, and how large tags are where that is known: what corners are refined through and become poses by."""

    lens: Lens
    tag_size_m: float | None
    refine: bool

    def pose(self, tag: TagDetection) -> TagPose | None:
        size_m = self.tag_size_m
        return None if size_m is None else tag_pose(self.lens, tag.corners_px, size_m, tag.refined)

    def axes_px(self, pose: TagPose) -> Array:
        """Return the (4, 2) pixels of the tag's origin and of the ends of axes half a tag long."""
        ends_m = np.vstack([np.zeros(3), 0.5 * (self.tag_size_m or 0.0) * np.eye(3)])
        return self.lens.project(apply(pose.T_camera_tag, ends_m))


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """One picture's tags, each with its pose where that was asked for and found."""

    image: GreyImage
    found: TagDetections
    poses: tuple[TagPose | None, ...]


@dataclass(frozen=True, slots=True)
class _Fault:
    """What could not be used, and a sentence why."""

    image: str
    frame: int
    error: str


def detect(
    images: Annotated[list[str], typer.Argument(metavar="IMAGES...", help="Pictures, folders, globs or videos.")],
    detector: Annotated[str, typer.Option(help="pyapriltags, pupil or opencv.")] = "pyapriltags",
    families: Annotated[str | None, typer.Option(help="Tag families, separated by commas [tag36h11].")] = None,
    decimate: Annotated[
        float | None, typer.Option(help="Search in a picture shrunk by this: 1, 1.5, 2, 3 or 4 [1].")
    ] = None,
    border_bits: Annotated[
        int | None, typer.Option(help="Width of the black border; Kalibr's AprilGrids have 2 (opencv alone) [1].")
    ] = None,
    lens: Annotated[
        Path | None, typer.Option(help="YAML of the camera's lens: corners are refined through it.")
    ] = None,
    tag_size_m: Annotated[
        float | None, typer.Option(help="Side of the tags' black square: with --lens gives each tag's pose.")
    ] = None,
    refine: Annotated[
        bool | None, typer.Option("--refine/--no-refine", help="Refine corners through --lens [with a lens: yes].")
    ] = None,
    draw: Annotated[Path | None, typer.Option(help="Write the pictures with their tags to this folder.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a picture.")] = False,
) -> None:
    """Find AprilTags. Exit code 4 where some pictures could not be read, 2 where none could."""
    finder = _detector(detector, families, decimate, border_bits)
    ruler = _ruler(lens, tag_size_m, refine)
    if draw is not None:
        _make_folder(draw)
    paths, faults = _find(images)
    output = _Output(ruler, draw, as_json)
    for fault in faults:
        output.take(fault)
    if ruler is not None and ruler.refine:
        load_refinement()
    with progress_bar("detecting", pictures.count(paths), hidden=as_json) as progress:
        for picture in pictures.read(paths):
            output.take(_answer(picture, finder, ruler))
            progress.advance(progress.task_ids[0])
    output.finish()


class _Output:
    """Tells each answer as it comes, as JSON or in a table, and in the end what could not be used."""

    def __init__(self, ruler: _Ruler | None, draw: Path | None, as_json: bool) -> None:
        self._ruler = ruler
        self._draw = draw
        self._as_json = as_json
        self._table = Table("picture", "size", "tags", "ids", "ms")
        self._answered = 0
        self._faults: list[str] = []

    def take(self, answer: _Answer | _Fault) -> None:
        if isinstance(answer, _Fault):
            self._faults.append(f"{answer.image}: {answer.error}")
        else:
            if self._draw is not None:
                write_picture(
                    self._draw / f"{self._answered:04d}-{Path(answer.found.source).stem}.png", self._drawn(answer)
                )
            self._answered += 1
        if self._as_json:
            print_json(asdict(answer) if isinstance(answer, _Fault) else _as_json(answer))
        elif isinstance(answer, _Answer):
            self._table.add_row(*_row(answer))

    def finish(self) -> None:
        """Print the table; raises PartialError where some pictures could not be used, InputError where none could."""
        if self._answered and not self._as_json:
            results.print(self._table)
        if self._faults:
            total = len(self._faults) + self._answered
            text = "\n".join([f"{len(self._faults)} of {total} pictures could not be used:", *self._faults])
            raise PartialError(text) if self._answered else InputError(text)

    def _drawn(self, answer: _Answer) -> ColourImage:
        ruler = self._ruler
        axes = [None if pose is None or ruler is None else ruler.axes_px(pose) for pose in answer.poses]
        return draw_tags(answer.image, answer.found.tags, axes)


def _detector(name: str, families: str | None, decimate: float | None, border_bits: int | None) -> TagDetector:
    plugin = load_plugin("detectors", name)
    given: dict[str, object] = {"decimate": decimate, "border_bits": border_bits}
    if families is not None:
        given["families"] = tuple(family.strip() for family in families.split(","))
    try:
        section = plugin.section(**{key: value for key, value in given.items() if value is not None})
    except ValidationError as error:
        raise InputError("\n".join(_option_fault(name, dict(detail)) for detail in error.errors())) from error
    detector: TagDetector = plugin.make(section)
    return detector


def _option_fault(detector: str, detail: Mapping[str, object]) -> str:
    location = detail["loc"]
    option = "--" + str(location[0] if isinstance(location, tuple) else location).replace("_", "-")
    if detail["type"] == "extra_forbidden":
        return f"detector {detector} has no {option}"
    return f"{option}: {str(detail['msg']).removeprefix('Value error, ')}"


def _ruler(lens: Path | None, tag_size_m: float | None, refine: bool | None) -> _Ruler | None:
    if lens is None and tag_size_m is not None:
        raise InputError("--tag-size-m gives a pose only with --lens")
    if lens is None and refine:
        raise InputError("--refine needs --lens: corners are refined through the camera's lens")
    if tag_size_m is not None and not 0.0 < tag_size_m <= 5.0:
        raise InputError(f"--tag-size-m is metres above 0 and up to 5, not {tag_size_m:g}")
    return None if lens is None else _Ruler(_load_lens(lens), tag_size_m, refine is not False)


def _load_lens(path: Path) -> Lens:
    """Read a lens: its keys alone, or a ``lenses:`` section that holds one."""
    document = load_document(path)
    if "lenses" not in document.data:
        model, faults = document.validate(LensModel, document.data)
    else:
        lenses = document.data["lenses"]
        if not isinstance(lenses, dict) or len(lenses) != 1:
            raise ConfigError([document.fault(("lenses",), "must hold exactly one lens for --lens")])
        name, data = next(iter(lenses.items()))
        model, faults = document.validate(LensModel, data, ("lenses", name))
    if model is None:
        raise ConfigError(faults)
    return model.build()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--draw: folder {folder} cannot be made: {error.strerror}") from error


def _find(places: Sequence[str]) -> tuple[list[Path], list[_Fault]]:
    """Return the files of all places, and a fault for each place without any."""
    paths: list[Path] = []
    faults: list[_Fault] = []
    for place in places:
        try:
            paths += pictures.find(place)
        except InputError as error:
            faults.append(_Fault(place, 0, str(error).removeprefix(place).lstrip(": ")))
    return paths, faults


def _answer(picture: Picture, detector: TagDetector, ruler: _Ruler | None) -> _Answer | _Fault:
    source = str(picture.path)
    if picture.image is None:
        return _Fault(source, picture.frame, picture.fault)
    height, width = picture.image.shape
    if ruler is not None and (width, height) != ruler.lens.size_px:
        lens_width, lens_height = ruler.lens.size_px
        return _Fault(source, picture.frame, f"is {width}x{height} px, the lens {lens_width}x{lens_height} px")
    frame = Frame("", picture.image, 0.0, picture.frame, stamp_known=False, source=source)
    try:
        found = detect_tags(frame, detector, RealClock().now_s, lens=ruler.lens if ruler and ruler.refine else None)
    except InputError as error:
        return _Fault(source, picture.frame, str(error))
    return _Answer(picture.image, found, tuple(None if ruler is None else ruler.pose(tag) for tag in found.tags))


def _row(answer: _Answer) -> tuple[str, ...]:
    found = answer.found
    ids = ", ".join(
        f"{tag.key.id}{'' if pose is None else f' ({np.linalg.norm(pose.T_camera_tag[:3, 3]):.3f} m)'}"
        for tag, pose in zip(found.tags, answer.poses, strict=True)
    )
    name = found.source if found.sequence == 0 else f"{found.source} [{found.sequence}]"
    width, height = found.size_px
    return escape(name), f"{width}x{height}", str(len(found.tags)), ids, f"{1000.0 * found.detect_s:.1f}"


def _as_json(answer: _Answer) -> dict[str, object]:
    found = answer.found
    return {
        "image": found.source,
        "frame": found.sequence,
        "size_px": list(found.size_px),
        "tags": [_tag_json(tag, pose) for tag, pose in zip(found.tags, answer.poses, strict=True)],
        "detect_s": round(found.detect_s, 6),
    }


def _tag_json(tag: TagDetection, pose: TagPose | None) -> dict[str, object]:
    return {
        "family": tag.key.family,
        "id": tag.key.id,
        "hamming": tag.hamming,
        "margin": round(tag.margin, 2),
        "center_px": [round(value, 3) for value in tag.centre_px],
        "corners_px": np.round(tag.corners_px, 3).tolist(),
        "pose": None
        if pose is None
        else {
            "T_camera_tag": pose.T_camera_tag.tolist(),
            "sigma_m": pose.sigma_m.tolist(),
            "alternatives": pose.alternatives,
        },
        "refined": list(tag.refined),
    }
