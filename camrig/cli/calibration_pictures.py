"""What calibrations from pictures share: whose they are, of which instant, at which aim, and what marks they show."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from camrig import pictures
from camrig.calibrate.boards import AprilGrid, Board, Charuco
from camrig.calibrate.find_boards import find_board
from camrig.calibrate.instants import instants_of
from camrig.calibrate.sighted import SeenBoard, Shot
from camrig.cli.console import progress_bar
from camrig.cli.refinement import load_refinement
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig
from camrig.detect import detect_tags
from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage
from camrig.geometry.corner_noise import tag_width_px
from camrig.geometry.lens import Lens
from camrig.interfaces import TagDetector
from camrig.locate.tags import MIN_WIDTH_PX, cut_by_edge
from camrig.messages import Frame, TagDetection
from camrig.rig import HeadMount, Rig, TagKey

AIM = re.compile(r"_pan([+-]?\d+(?:\.\d+)?)_tilt([+-]?\d+(?:\.\d+)?)$")
"""How a picture's name says where its head pointed, in degrees."""

AIMS_FILE = "aims.csv"
"""What says it for a whole folder: columns ``picture``, ``pan_deg``, ``tilt_deg``."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Which pictures (by camera), which boards may be in them, and the file with their stamps."""

    places: Mapping[str, str]
    boards: Mapping[str, Board] = field(default_factory=dict)
    stamps: Path | None = None


def places_of(given: Sequence[str], rig: Rig) -> dict[str, str]:
    """Return where each camera's pictures are; raises InputError where that is not said well."""
    places: dict[str, str] = {}
    for each in given:
        name, equals, place = each.partition("=")
        if not equals or not place:
            raise InputError(f"--from-images {each}: write CAMERA=PICTURES, as in --from-images north=walk/north")
        if name not in rig.cameras:
            raise InputError(f"--from-images: rig '{rig.name}' has no camera '{name}'; it has {', '.join(rig.cameras)}")
        if name in places:
            raise InputError(f"--from-images: '{name}' is there twice; put its pictures into one folder")
        places[name] = place
    return places


def listed_sizes_m(rig: Rig) -> dict[str, float]:
    """Return the sizes of all tags that a rig lists."""
    sizes_m = {str(tag.key): tag.size_m for body in rig.targets.values() for tag in body.tags}
    return sizes_m | {str(anchor.key): anchor.size_m for anchor in rig.anchors}


def read_shots(config: RigConfig, asked: Asked, *, hidden: bool) -> tuple[list[Shot], list[str]]:
    """Find tags and boards in all pictures; return them, and a sentence for each picture that cannot be used.

    Raises InputError where none can.
    """
    files = {name: pictures.find(place) for name, place in asked.places.items()}
    instants = _stamped(asked.stamps, files)
    detector: TagDetector = config.detector.plugin.make(config.detector.section)
    if config.refine:
        load_refinement()
    shots: list[Shot] = []
    faults: list[str] = []
    with progress_bar("detecting", sum(pictures.count(paths) for paths in files.values()), hidden=hidden) as progress:
        for name, paths in files.items():
            of_camera = _Camera(config, name, detector, asked.boards, _aims(config.rig, name, paths))
            for found in of_camera.shots(paths, None if instants is None else instants[name]):
                if isinstance(found, Shot):
                    shots.append(found)
                else:
                    faults.append(found)
                progress.advance(progress.task_ids[0])
    if faults and not shots:
        raise InputError("\n".join(["no picture can be used:", *faults]))
    return shots, faults


@contextmanager
def blaming(faults: Sequence[str]) -> Iterator[None]:
    """Name what could not be used, too, where the rest is refused inside: it may be for want of that."""
    try:
        yield
    except InputError as error:
        if not faults:
            raise
        raise InputError("\n".join([str(error), f"{len(faults)} could not be used:", *faults])) from error


def usable_tags(tags: Sequence[TagDetection], lens: Lens) -> dict[str, Array]:
    """Return the corners of tags by name: none that the picture's edge cuts, that is too small to be real, or whose
    number is there twice.
    """
    if not tags:
        return {}
    corners_px = np.stack([tag.corners_px for tag in tags])
    refined = np.array([tag.refined for tag in tags])
    width_px = tag_width_px(corners_px)
    bad = (width_px < MIN_WIDTH_PX) | cut_by_edge(corners_px, refined, width_px, lens.size_px)
    counts = Counter(tag.key for tag in tags)
    return {
        str(tag.key): tag.corners_px
        for tag, left_out in zip(tags, bad, strict=True)
        if not left_out and counts[tag.key] == 1
    }


@dataclass(frozen=True, slots=True)
class _Camera:
    """Looks at one camera's pictures."""

    config: RigConfig
    name: str
    detector: TagDetector
    boards: Mapping[str, Board]
    aims: Mapping[Path, tuple[float, float]]

    def shots(self, paths: Sequence[Path], instants: Sequence[int] | None) -> Iterator[Shot | str]:
        lens = self.config.rig.cameras[self.name].lens
        for k, picture in enumerate(pictures.read(paths)):
            about = f"{picture.path} [{picture.frame}]" if pictures.is_video(picture.path) else str(picture.path)
            if picture.image is None:
                yield f"{about}: {picture.fault}"
            elif instants is not None and k >= len(instants):
                yield f"{about}: the file of stamps has only {len(instants)} of {self.name}"
            elif (instant := _instant(picture) if instants is None else instants[k]) is None:
                yield f"{about}: has no number in its name, which tells pictures of one instant"
            elif (size := picture.image.shape[::-1]) != lens.size_px:
                yield f"{about}: is {size[0]}x{size[1]} px, {self.name}'s lens {lens.size_px[0]}x{lens.size_px[1]} px"
            elif self.aims and picture.path not in self.aims:
                yield f"{about}: does not say where its head pointed, as its others do"
            else:
                yield self._shot(picture.image, instant, about, self.aims.get(picture.path))

    def _shot(self, image: GreyImage, instant: int, about: str, aim_rad: tuple[float, float] | None) -> Shot:
        lens = self.config.rig.cameras[self.name].lens
        frame = Frame(self.name, image, 0.0, instant, stamp_known=False, source=about)
        found = detect_tags(frame, self.detector, RealClock().now_s, lens=lens if self.config.refine else None)
        views = {name: (board, find_board(image, board, self.detector)) for name, board in self.boards.items()}
        seen = {
            name: SeenBoard(board.points_m[view.ids], view.corners_px)
            for name, (board, view) in views.items()
            if view is not None
        }
        alone = [tag for tag in found.tags if not any(_is_on(tag.key, board) for board in self.boards.values())]
        return Shot(self.name, instant, usable_tags(alone, lens), seen, aim_rad)


def _is_on(key: TagKey, board: Board) -> bool:
    """Tell whether a tag is part of a board."""
    match board:
        case AprilGrid():
            return key.family == "tag36h11" and 0 <= key.id - board.first_id < board.columns * board.rows
        case Charuco():
            return key.family == "tag36h11" and board.dictionary == "apriltag_36h11"
        case _:
            return False


def _instant(picture: pictures.Picture) -> int | None:
    if pictures.is_video(picture.path):
        return picture.frame
    numbers = re.findall(r"\d+", AIM.sub("", picture.path.stem))
    return int(numbers[-1]) if numbers else None


def _aims(rig: Rig, name: str, paths: Sequence[Path]) -> dict[Path, tuple[float, float]]:
    """Return where the head of a camera pointed in each picture that says so, by its name or ``aims.csv`` beside it."""
    if not isinstance(rig.cameras[name].mount, HeadMount):
        return {}
    listed: dict[Path, tuple[float, float]] = {}
    for folder in {path.parent for path in paths}:
        listed |= _listed_aims(folder / AIMS_FILE)
    aims = {path: tuple(map(float, found.groups())) for path in paths if (found := AIM.search(path.stem))}
    return {path: (math.radians(pan), math.radians(tilt)) for path, (pan, tilt) in {**listed, **aims}.items()}


def _listed_aims(file: Path) -> dict[Path, tuple[float, float]]:
    if not file.is_file():
        return {}
    return {
        file.parent / row["picture"]: (_number(file, row, "pan_deg"), _number(file, row, "tilt_deg"))
        for row in _rows(file, ("picture", "pan_deg", "tilt_deg"))
    }


def _stamped(file: Path | None, files: Mapping[str, Sequence[Path]]) -> dict[str, list[int]] | None:
    """Return the instants of each camera's pictures, in their order, by a file with a stamp for each."""
    if file is None:
        return None
    stamps: dict[str, list[float]] = {name: [] for name in files}
    for row in _rows(file, ("camera", "stamp_s")):
        if row["camera"] in stamps:
            stamps[row["camera"]].append(_number(file, row, "stamp_s"))
    if missing := [name for name, own in stamps.items() if not own]:
        raise InputError(f"{file}: has no stamp of {', '.join(missing)}")
    instants = instants_of({name: np.array(own) for name, own in stamps.items()})
    return {name: own.tolist() for name, own in instants.items()}


def _rows(file: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    try:
        with file.open(newline="", encoding="utf-8") as text:
            rows = list(csv.DictReader(text))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file} cannot be read: {error}") from error
    if missing := [column for column in columns if rows and column not in rows[0]]:
        raise InputError(f"{file}: has no column {', '.join(missing)}; its first line must name {', '.join(columns)}")
    return rows


def _number(file: Path, row: Mapping[str, str], column: str) -> float:
    try:
        value = float(row[column])
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        said = f"{column} is '{row[column]}', which is no number" if row[column] else f"a line has no {column}"
        raise InputError(f"{file}: {said}")
    return value
