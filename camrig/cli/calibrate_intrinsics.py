"""``camrig calibrate intrinsics``: a camera's lens, from pictures of a board."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from camrig.calibrate.boards import AprilGrid, Board, board_word, parse_board
from camrig.calibrate.intrinsics import Intrinsics, Kind, calibrate_lens, steps
from camrig.cli.asked_files import check_files, collected, write_report
from camrig.cli.board_shots import BoardShots, read_shots, through_lens
from camrig.cli.console import note, print_json, progress_bar
from camrig.cli.intrinsics_answer import as_json, print_lens
from camrig.cli.lens_exchange import into_file
from camrig.cli.live_shots import live_shots
from camrig.config.amend import amend_rig, check_amendable
from camrig.config.document import load_document
from camrig.config.kept_file import former
from camrig.config.lens_book import check_place
from camrig.config.lens_entry import lens_changes, lens_entry, lens_places
from camrig.config.rig_file import RigConfig, load_rig
from camrig.errors import InputError, PartialError
from camrig.report.intrinsics_report import intrinsics_report

_NAMELESS = "lens"
"""What a lens is called in --out where no camera is named."""


def intrinsics(
    config: Annotated[Path | None, typer.Argument(help="The rig's YAML file.")] = None,
    camera: Annotated[str | None, typer.Argument(help="The camera of it whose lens this is.")] = None,
    from_images: Annotated[
        list[str] | None, typer.Option(metavar="PICTURES", help="Folder or glob of pictures of the board.")
    ] = None,
    from_video: Annotated[list[str] | None, typer.Option(metavar="VIDEO", help="A video of the board.")] = None,
    board: Annotated[
        str | None, typer.Option(help="As its sheet says, chessboard:7x5:30 (inner corners, mm) [recognised].")
    ] = None,
    square_mm: Annotated[
        float | None, typer.Option(help="Side of the squares of a board that is recognised; an AprilGrid's tags.")
    ] = None,
    kind: Annotated[Kind, typer.Option(help="Lenses that are tried.")] = Kind.AUTO,
    zoom_position: Annotated[
        float | None, typer.Option(help="The zoom's position: fills that row of the lens in --out.")
    ] = None,
    write_rig: Annotated[bool, typer.Option("--write", help="Write the lens into the rig's file.")] = False,
    out: Annotated[Path | None, typer.Option(help="Put the lens into a file of lenses, for detect --lens.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page of HTML with figures.")] = None,
    as_json_line: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find a camera's lens from pictures of a board, held still and sharp, near and far, tilted to all sides.

    Without pictures the rig's camera takes them itself whenever the board is still, and says how to hold it next.
    Which board it is, is recognised. Bad pictures are set aside by name, the lens has as many numbers as the pictures
    speak for, and what it is worth is told in millimetres. Nothing is written without --write, --out or --report. Exit
    code 4 where some pictures could not be read.
    """
    rig = _rig(config, camera, write_rig=write_rig)
    places = [*(from_images or ()), *(from_video or ())]
    if zoom_position is not None and out is None:
        raise InputError("--zoom-position fills a row of the lens in a file: give it, --out LENS.yaml")
    check_files({"--out": out, "--report": report}, config)
    _check_places(config if write_rig else None, camera, out, zoom=zoom_position is not None)
    known, square_m = _board(board, square_mm)
    if places:
        seen = read_shots(places, known, square_m, hidden=as_json_line)
    elif rig is not None and camera is not None:
        seen = live_shots(rig, camera, known, square_m, hidden=as_json_line)
    else:
        raise InputError("give pictures of the board, --from-images FOLDER or --from-video FILE, or a rig's camera")
    if rig is not None and camera is not None and rig.rig.cameras[camera].lens.size_px != seen.size_px:
        (width, height), (own_width, own_height) = seen.size_px, rig.rig.cameras[camera].lens.size_px
        raise InputError(
            f"pictures are {width}x{height} px, camera '{camera}' delivers {own_width}x{own_height} px: "
            "take them with this camera as the rig runs it"
        )
    found = _fitted(seen, kind, hidden=as_json_line)
    if isinstance(seen.board, AprilGrid) and (known is None or not seen.board.like_kalibrs):
        seen = through_lens(places, seen, found.unbounded, measure=known is None, hidden=as_json_line)
        if known is None:
            note(f"the gap between tags is measured: {board_word(seen.board)}; --board says it exactly")
        found = _fitted(seen, kind, hidden=as_json_line)
    last = None if rig is None or camera is None else rig.rig.cameras[camera].lens
    entry = lens_entry(found.lens, found.distortion)
    unwritten: list[str] = []
    written = _write(config if write_rig else None, camera, out, zoom_position, found, entry, unwritten)
    if report is not None:
        title = f"Lens of {camera}" if camera else "Lens"
        made = f"{len(seen.shots)} pictures of {board_word(seen.board)}, {seen.size_px[0]}x{seen.size_px[1]} px"
        with collected(unwritten):
            write_report(report, intrinsics_report(title, found, seen.shots, made))
            written.append(str(report))
    if as_json_line:
        print_json(as_json(found, seen, last, written))
    else:
        print_lens(found, seen, last, entry)
        _tell_written(written, config, camera)
    unread = [f"{len(seen.faults)} pictures could not be read:", *seen.faults] if seen.faults else []
    if unwritten or unread:
        raise PartialError("\n".join([*unwritten, *unread]))


def _rig(config: Path | None, camera: str | None, *, write_rig: bool) -> RigConfig | None:
    if config is None or camera is None:
        if write_rig:
            raise InputError("--write needs the rig's file and the camera, as in rig.yaml north")
        if config is not None:
            raise InputError(f"whose lens is it? Name a camera of {config}, as in {config} north")
        return None
    rig = load_rig(config)
    if camera not in rig.rig.cameras:
        raise InputError(f"rig '{rig.rig.name}' has no camera '{camera}'; it has {', '.join(rig.rig.cameras)}")
    return rig


def _check_places(config: Path | None, camera: str | None, out: Path | None, *, zoom: bool) -> None:
    """Raise InputError where files cannot take the lens."""
    if out is not None:
        check_place(out, camera or _NAMELESS, zoom=zoom)
    if config is not None and camera is not None:
        check_amendable(config, lens_places(load_document(config), camera))


def _fitted(seen: BoardShots, kind: Kind, *, hidden: bool) -> Intrinsics:
    with progress_bar("fitting lenses", steps(kind), hidden=hidden) as progress:
        return calibrate_lens(
            seen.shots, seen.board, seen.size_px, kind, lambda: progress.advance(progress.task_ids[0])
        )


def _board(board: str | None, square_mm: float | None) -> tuple[Board | None, float | None]:
    """Return the board that is named, and the squares of one that is not."""
    if square_mm is not None and not 0.0 < square_mm <= 5000.0:
        raise InputError(f"--square-mm is above 0 and up to 5000, not {square_mm:g}")
    if square_mm is not None and board is not None:
        raise InputError("--square-mm is for a board that is recognised; --board says its size itself")
    return None if board is None else parse_board(board), None if square_mm is None else square_mm / 1000.0


def _write(
    config: Path | None,
    camera: str | None,
    out: Path | None,
    zoom_position: float | None,
    found: Intrinsics,
    entry: dict[str, Any],
    unwritten: list[str],
) -> list[str]:
    """Write what was asked for; return the files, and put what was refused into ``unwritten``."""
    written = []
    if config is not None and camera is not None:
        with collected(unwritten):
            amend_rig(config, lens_changes(load_document(config), camera, entry, found.sigma))
            written.append(str(config))
    if out is not None:
        with collected(unwritten):
            into_file(out, camera or _NAMELESS, entry, zoom_position)
            written.append(str(out))
    return written


def _tell_written(written: list[str], config: Path | None, camera: str | None) -> None:
    for file in written:
        kept = former(Path(file))
        note(f"written: {file}" + (f"; the version before is {kept}" if kept.exists() else ""))
    if config is not None and str(config) not in written:
        note(f"nothing is written to {config}; --write puts this lens in for {camera}")
