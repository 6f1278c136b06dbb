"""``camrig calibrate extrinsics``: where a rig's cameras and heads are, from pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from camrig.calibrate.boards import Board, board_word, parse_board
from camrig.calibrate.scale import Length, with_lengths
from camrig.calibrate.setup import CARRIED, OnHead, Setup
from camrig.calibrate.sighted import ROOM, Shot
from camrig.calibrate.stillness import Moved, Stillness, stillness, without_moved
from camrig.cli.asked_files import check_files, collected, write_report
from camrig.cli.calibration_pictures import Asked, blaming, listed_sizes_m, places_of, read_shots
from camrig.cli.console import note, people, print_json
from camrig.cli.extrinsics_answer import Answer
from camrig.cli.extrinsics_changes import changes, in_words, places_to_write, tell_unwritten, today
from camrig.cli.extrinsics_live import look_round, seeing
from camrig.config.amend import amend_rig, check_amendable
from camrig.config.rig_file import load_rig
from camrig.errors import InputError, PartialError
from camrig.geometry.arrays import Transform
from camrig.rig import DroneMount, FixedMount, HeadMount, Rig


def extrinsics(
    config: Annotated[
        Path, typer.Argument(help="The rig's YAML file: cameras, lenses, heads, sizes of tags, anchors.")
    ],
    from_images: Annotated[
        list[str] | None,
        typer.Option(metavar="CAMERA=PICTURES", help="A camera's pictures: folder, glob or video."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Look through the rig's own cameras, and turn its heads round.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --live: move without asking; nobody is in the way.")] = False,
    tag_size_m: Annotated[
        float | None, typer.Option(help="Side of the black square of tags that the file does not list.")
    ] = None,
    board: Annotated[
        list[str] | None, typer.Option(metavar="BOARD", help="A board in the pictures, as in charuco:5x4:54:40.5.")
    ] = None,
    length: Annotated[
        list[str] | None,
        typer.Option(metavar="TAG-TAG=M", help="A measured distance of two tags' centres; sets all tags' sizes."),
    ] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="TAG", help="The tag on the floor that is the world; anchors are free then.")
    ] = None,
    keep: Annotated[
        str | None, typer.Option(metavar="CAMERA", help="Without anchors: the camera that stays where the file has it.")
    ] = None,
    mounts: Annotated[bool, typer.Option("--mounts", help="Find how cameras sit on their heads, too.")] = False,
    stamps: Annotated[
        Path | None, typer.Option(metavar="CSV", help="When pictures were taken: columns camera, stamp_s, in order.")
    ] = None,
    write: Annotated[bool, typer.Option("--write", help="Write the result into the rig's file.")] = False,
    anchors: Annotated[bool, typer.Option("--anchors", help="With --write: list the room's tags as anchors.")] = False,
    report: Annotated[Path | None, typer.Option(metavar="HTML", help="Write a page with figures.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Place cameras and heads by tags that stand in the room, a board that is carried past, or both.

    What keeps its place in the pictures stands in the room, what is elsewhere in each is carried; anchors of the file,
    `--origin` or `--keep` say where the world is. Pictures of one instant bear the same number, the last in their
    file's name; of a video the number of the frame counts; `--stamps` goes before both. A head may stand at several
    aims, which the names of its camera's pictures say: `north-012_pan+030.0_tilt-045.0.png`. `--live` takes pictures
    itself, of what stands: it turns one head after the other within its limits, after asking. Cameras on drones have no
    place. Exit code 4 where a camera or a picture could not be used, or the result is of no use. Nothing is written
    without `--write`.
    """
    rig_config = load_rig(config)
    rig = rig_config.rig
    if live == bool(from_images):
        raise InputError("say where pictures are, --from-images CAMERA=PICTURES, or --live to take them now")
    places = seeing(rig) if live else places_of(from_images or (), rig)
    boards = _boards(board or ())
    lengths = [_length(each) for each in length or ()]
    _refuse(rig, places, origin=origin, keep=keep, tag_size_m=tag_size_m)
    check_files({"--report": report}, config, stamps)
    if write:
        check_amendable(config, places_to_write(rig, places, anchors=anchors, mounts=mounts))
    if live:
        shots, faults = look_round(rig_config, yes=yes, hidden=as_json)
    else:
        shots, faults = read_shots(rig_config, Asked(places, boards, stamps), hidden=as_json)
    with blaming(faults):
        if origin and not any(origin in shot.corners_px for shot in shots):
            raise InputError(f"--origin {origin}: no picture shows it whole")
        sizes_m = _sizes_m(config, rig, shots, tag_size_m, lengths)
        known = frozenset({origin} if origin else {str(anchor.key) for anchor in rig.anchors})
        sorted_out = stillness(shots, known)
        _refuse_walking(sorted_out, known)
        shots = without_moved(shots, sorted_out.moved)
        setup = _Given(rig, known, origin, keep, mounts, sorted_out).setup(places, sizes_m, shots)
        seen_boards = {name for shot in shots for name in shot.boards}
        with people.status("placing cameras"):
            placed = with_lengths(shots, setup, lengths, bool(seen_boards))
    unseen = (
        f"--board {board_word(of)}: no picture shows it" for name, of in boards.items() if name not in seen_boards
    )
    answer = Answer(rig, placed, (*_words(sorted_out.moved), *unseen), tuple(places))
    new = changes(answer, today(), anchors=anchors) if answer.in_world or write else {}
    if as_json:
        print_json({**answer.as_json(), "changes": in_words(new)})
    else:
        answer.print()
    bad = list(answer.lost())
    if not answer.is_usable:
        bad.append(f"this is not fit for use{', nothing was written' if write else ''}: see the warnings")
    elif write:
        with collected(bad):
            amend_rig(config, new)
            placed_cameras = ", ".join(answer.found.placed_cameras)
            note(f"{config} has the new places of {placed_cameras}; the former file is beside it")
    elif new and not as_json:
        tell_unwritten(new)
    if report is not None:
        with collected(bad):
            write_report(report, answer.report(f"camrig calibrate extrinsics {config}, {today()}"))
    if faults or bad:
        raise PartialError("\n".join([*bad, *faults]))


def _boards(words: Sequence[str]) -> dict[str, Board]:
    boards = [parse_board(word) for word in words]
    return {"board" if k == 0 else f"board{k + 1}": board for k, board in enumerate(boards)}


def _length(word: str) -> Length:
    names, equals, metres = word.partition("=")
    a, dash, b = names.partition("-")
    try:
        value = float(metres)
    except ValueError:
        value = np.nan
    if not (equals and dash and a and b and 0.0 < value < 1000.0):
        raise InputError(f"--length {word}: write TAG-TAG=METRES, as in --length tag36h11:3-tag36h11:7=1.500")
    return Length(a, b, value)


def _refuse(
    rig: Rig, places: Mapping[str, str], *, origin: str | None, keep: str | None, tag_size_m: float | None
) -> None:
    """Raise InputError for what cannot be asked."""
    for name in places:
        if isinstance(rig.cameras[name].mount, DroneMount):
            raise InputError(f"--from-images {name}: hangs on a drone, which has no place of its own")
    if origin and keep:
        raise InputError("--origin and --keep both say where the world is: give one")
    if keep and keep not in places:
        raise InputError(f"--keep {keep}: no pictures of it are given; of {', '.join(places)} there are")
    if keep and not isinstance(rig.cameras[keep].mount, FixedMount | HeadMount):
        raise InputError(f"--keep {keep}: the file does not say where it is")
    if tag_size_m is not None and not 0.0 < tag_size_m <= 5.0:
        raise InputError(f"--tag-size-m {tag_size_m:g}: must be above 0 and up to 5 m")


def _sizes_m(
    config: Path, rig: Rig, shots: Sequence[Shot], tag_size_m: float | None, lengths: Sequence[Length]
) -> dict[str, float]:
    """Return the sizes of all tags; one that nobody knows is any, where lengths set it right."""
    sizes_m = listed_sizes_m(rig)
    unsized = sorted({tag for shot in shots for tag in shot.corners_px} - sizes_m.keys())
    if unsized and tag_size_m is None and not lengths:
        raise InputError(
            f"{config} does not list {', '.join(unsized)}: give their size, --tag-size-m, or a --length between two"
        )
    if unsized and tag_size_m is None and sizes_m.keys() & {tag for shot in shots for tag in shot.corners_px}:
        raise InputError(f"{', '.join(unsized)}: of unknown size beside tags of known: give their size, --tag-size-m")
    return sizes_m | dict.fromkeys(unsized, tag_size_m or 0.1)


def _refuse_walking(found: Stillness, known: frozenset[str]) -> None:
    if found.walking:
        raise InputError(
            f"{', '.join(sorted(known))} stand in the room, and move before {', '.join(found.walking)}: cameras must "
            "keep still; of one on a head pictures say its aim, as in north-012_pan+030.0_tilt-045.0.png"
        )


@dataclass(frozen=True, slots=True)
class _Given:
    """What the file and the command line say."""

    rig: Rig
    known: frozenset[str]
    origin: str | None
    keep: str | None
    mounts: bool
    sorted_out: Stillness

    def setup(self, places: Mapping[str, str], sizes_m: Mapping[str, float], shots: Sequence[Shot]) -> Setup:
        """Say it as ``camrig.calibrate`` takes it."""
        targets = {str(tag.key): body.id for body in self.rig.targets.values() for tag in body.tags}
        bodies = {mark: targets.get(mark, CARRIED) for mark in self.sorted_out.carried}
        bodies |= {name: name for shot in shots for name in shot.boards if name in self.sorted_out.carried}
        bodies |= dict.fromkeys(self.sorted_out.still - self.known, ROOM)
        anchors = {str(anchor.key): anchor.T_world_tag for anchor in self.rig.anchors if str(anchor.key) in self.known}
        aimed = {shot.camera_id for shot in shots if shot.aim_rad is not None}
        return Setup(
            lenses={name: self.rig.cameras[name].lens for name in places},
            sizes_m=sizes_m,
            anchors={self.origin: np.eye(4)} if self.origin else anchors,
            bodies=bodies,
            heads={name: self._head(name) for name in places if name in aimed},
            kept={self.keep: self._place_of(self.keep, self.keep in aimed)} if self.keep else {},
        )

    def _head(self, name: str) -> OnHead:
        mount = self.rig.cameras[name].mount
        assert isinstance(mount, HeadMount)
        head = self.rig.heads[mount.head]
        return OnHead(head.kinematics.T_arm_tilt, mount.T_mount_camera, max(head.bias_sigma_rad, 1e-5), self.mounts)

    def _place_of(self, name: str, aimed: bool) -> Transform:
        mount = self.rig.cameras[name].mount
        if isinstance(mount, FixedMount):
            return mount.T_world_camera
        if isinstance(mount, HeadMount) and aimed:
            return self.rig.heads[mount.head].kinematics.T_world_base
        raise InputError(f"--keep {name}: its pictures do not say where its head pointed")


def _words(moved: Sequence[Moved]) -> Iterator[str]:
    for each in moved:
        what = f"{each.mark} was moved" if each.mark else f"{each.camera} was moved"
        yield (
            f"{what} before instant {each.instant}, by {each.by_px:.0f} px in {each.camera}'s pictures: "
            "only what was taken earlier is used"
        )
