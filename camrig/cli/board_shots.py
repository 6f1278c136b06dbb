"""Pictures read, and the board found in each: what calibrations from pictures of a board begin with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from camrig import pictures
from camrig.calibrate.boards import AprilGrid, Board, board_word, scaled
from camrig.calibrate.find_boards import LEAST_SIDE_PX, find_board, refined_through
from camrig.calibrate.recognise import recognise, with_measured_gap
from camrig.calibrate.shots import Shot, edge_width_px
from camrig.cli.console import people, progress_bar
from camrig.cli.refinement import load_refinement
from camrig.errors import InputError
from camrig.geometry.arrays import GreyImage
from camrig.geometry.lens import Lens
from camrig.interfaces import TagDetector
from camrig.pictures import Picture
from camrig.plugins import load_plugin

_LOOKED_AT = 8
"""So many pictures tell which board it is."""

_MOST_FRAMES = 400
"""Of a longer video, so many frames, evenly."""


@dataclass(frozen=True, slots=True)
class BoardShots:
    """The pictures that show the board, the names of those that do not, and a sentence for each that cannot be read."""

    board: Board
    size_px: tuple[int, int]
    shots: tuple[Shot, ...]
    without: tuple[str, ...]
    faults: tuple[str, ...]


def read_shots(places: Sequence[str], board: Board | None, square_m: float | None, *, hidden: bool) -> BoardShots:
    """Read all pictures of some places; without a board, recognise it, its squares as large as is said.

    Raises InputError where the board is nowhere, or pictures differ in size.
    """
    paths = [path for place in places for path in pictures.find(place)]
    sizes, faults, sample = _looked_through(paths, hidden=hidden)
    size_px = _one_size(sizes, faults)
    if board is None:
        board = _recognised(sample, square_m)
    tags = tag_detector() if isinstance(board, AprilGrid) else None
    shots, without = [], []
    with progress_bar("finding the board", pictures.count(paths), hidden=hidden) as progress:
        for picture in _thinned(paths):
            if picture.image is not None and min(picture.image.shape) >= LEAST_SIDE_PX:
                view = find_board(picture.image, board, tags)
                if view is None:
                    without.append(_name(picture))
                else:
                    shots.append(Shot(_name(picture), view, edge_width_px(picture.image, view, board)))
            progress.advance(progress.task_ids[0])
    if not shots:
        raise InputError(_nowhere(board, sample, len(without)))
    return BoardShots(board, size_px, tuple(shots), tuple(without), tuple(faults))


def through_lens(places: Sequence[str], seen: BoardShots, lens: Lens, *, measure: bool, hidden: bool) -> BoardShots:
    """Return the shots of an AprilGrid as they are through a lens that is nearly right: corners of plain tags refined
    in the pictures of ``places``, and the gap between tags measured where nobody has said it.
    """
    board = seen.board
    assert isinstance(board, AprilGrid)
    shots = {shot.name: shot for shot in seen.shots}
    paths = [path for place in places for path in pictures.find(place)] if not board.like_kalibrs else []
    if paths:
        load_refinement()
    with progress_bar("refining corners", pictures.count(paths), hidden=hidden) as progress:
        for picture in _thinned(paths):
            shot = shots.get(_name(picture))
            if shot is not None and picture.image is not None:
                shots[shot.name] = replace(shot, view=refined_through(lens, picture.image, shot.view))
            progress.advance(progress.task_ids[0])
    if measure:
        board = with_measured_gap(board, [(s.view.ids, lens.unproject(s.view.corners_px)) for s in shots.values()])
    return replace(seen, board=board, shots=tuple(shots.values()))


def tag_detector() -> TagDetector:
    """Return what finds the tags of AprilGrids."""
    plugin = load_plugin("detectors", "pyapriltags")
    detector: TagDetector = plugin.make(plugin.section())
    return detector


def _looked_through(
    paths: Sequence[Path], *, hidden: bool
) -> tuple[dict[str, tuple[int, int]], list[str], list[GreyImage]]:
    """Return the size of every picture by name, a sentence for each that cannot be read, and a few pictures."""
    sizes: dict[str, tuple[int, int]] = {}
    faults: list[str] = []
    sample: list[GreyImage] = []
    total = pictures.count(paths)
    with progress_bar("reading", total, hidden=hidden) as progress:
        for index, picture in enumerate(_thinned(paths)):
            if picture.image is None:
                faults.append(f"{_name(picture)}: {picture.fault}")
            else:
                height, width = picture.image.shape
                sizes[_name(picture)] = (width, height)
                if index % max(1, min(total, _MOST_FRAMES) // _LOOKED_AT) == 0:
                    sample.append(picture.image.copy())
            progress.advance(progress.task_ids[0])
    return sizes, faults, sample


def _thinned(paths: Sequence[Path]) -> Iterator[Picture]:
    """Yield all pictures, and of videos as many frames as are worth looking at; faults always."""
    for path in paths:
        every = max(1, pictures.count([path]) // _MOST_FRAMES) if pictures.is_video(path) else 1
        yield from (
            each for index, each in enumerate(pictures.read([path])) if index % every == 0 or each.image is None
        )


def _one_size(sizes: dict[str, tuple[int, int]], faults: Sequence[str]) -> tuple[int, int]:
    if not sizes:
        raise InputError("\n".join(["no picture could be read:", *faults]))
    counts = Counter(sizes.values()).most_common()
    if len(counts) > 1:
        (usual, count), *_ = counts
        odd = [f"{name} ({size[0]}x{size[1]} px)" for name, size in sizes.items() if size != usual]
        listed = ", ".join(odd[:5]) + (f" and {len(odd) - 5} more" if len(odd) > 5 else "")
        raise InputError(
            f"pictures of one lens are of one size: {count} are {usual[0]}x{usual[1]} px, but {listed}; "
            "take them away, or calibrate each size by itself"
        )
    return counts[0][0]


def _recognised(sample: Sequence[GreyImage], square_m: float | None) -> Board:
    with people.status("telling which board it is"):
        board = recognise(sample)
    if board is None:
        raise InputError(
            f"no board is recognised in the {len(sample)} pictures looked at: give it, as in --board chessboard:7x5:30 "
            "(inner corners, mm), --board charuco:8x6:30:22:4x4_1000 or --board aprilgrid:6x6:55:16.5"
        )
    return board if square_m is None else scaled(board, square_m)


def _nowhere(board: Board, sample: Sequence[GreyImage], looked: int) -> str:
    """Say that a board is nowhere, and what is there instead."""
    other = recognise(sample)
    there = f"; they show what looks like --board {board_word(other)}, sizes in squares" if other is not None else ""
    return f"no board {board_word(board)} is in any of {looked} pictures{there}"


def _name(picture: Picture) -> str:
    return f"{picture.path.name}[{picture.frame}]" if pictures.is_video(picture.path) else picture.path.name
