"""``camrig calibrate import`` and ``export``: lenses from and for other programs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from camrig.cli.asked_files import check_files
from camrig.cli.console import note, print_json, results
from camrig.config.amend import amend_rig
from camrig.config.document import load_document
from camrig.config.kept_file import write
from camrig.config.lens_book import check_place, lens_text, put_lens
from camrig.config.lens_entry import lens_changes, lens_entry
from camrig.config.lens_files import LensFormat, read_lenses, write_lens
from camrig.config.lenses import LensModel
from camrig.config.rig_file import load_rig
from camrig.errors import ConfigError, InputError


def import_lens(
    file: Annotated[Path, typer.Argument(help="ROS's camera_info, OpenCV's FileStorage or Kalibr's camchain.")],
    config: Annotated[Path | None, typer.Argument(help="The rig's YAML file.")] = None,
    camera: Annotated[str | None, typer.Argument(help="The camera of it that gets the lens.")] = None,
    size_px: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Size of pictures, where the file does not say it.")
    ] = None,
    write_rig: Annotated[bool, typer.Option("--write", help="Write the lens into the rig's file.")] = False,
    out: Annotated[Path | None, typer.Option(help="Put the lenses into a file of camrig's own.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Read a lens that another program calibrated, and print it as a rig's file has it. Whose file it is, is seen."""
    check_files({"--out": out}, file, config)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InputError(f"{file} cannot be read: {reason}") from error
    _check(config, camera, write_rig=write_rig)
    try:
        how, lenses = read_lenses(text, camera or file.stem, _size(size_px))
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if out is not None:
        for name in lenses:
            check_place(out, name, zoom=False)
    entries = {name: _entry(lens) for name, lens in lenses.items()}
    if write_rig and config is not None and camera is not None:
        _put(config, camera, lenses)
    if out is not None:
        for name, entry in entries.items():
            into_file(out, name, entry)
    if as_json:
        print_json({"format": str(how), "lenses": entries})
    else:
        results.print(lens_text(entries).rstrip(), markup=False, highlight=False, soft_wrap=True)
        if not write_rig and config is not None:
            note(f"nothing is written to {config}; --write puts this lens in")


def export_lens(
    file: Annotated[Path, typer.Argument(help="The rig's YAML file, or one with lenses alone.")],
    lens: Annotated[str, typer.Argument(help="The lens, by its name there.")],
    how: Annotated[LensFormat, typer.Option("--format", help="Whose file to write.")] = LensFormat.ROS,
    out: Annotated[Path | None, typer.Option(help="The file [printed].")] = None,
) -> None:
    """Write a lens for another program. ``r_max`` is camrig's own and is not in it."""
    check_files({"--out": out}, file)
    document = load_document(file)
    lenses = document.data.get("lenses")
    if not isinstance(lenses, dict) or lens not in lenses:
        there = ", ".join(map(str, lenses)) if isinstance(lenses, dict) and lenses else "none"
        raise InputError(f"{file} has no lens '{lens}'; it has {there}")
    if isinstance(lenses[lens], dict) and "zoom" in lenses[lens]:
        raise InputError(f"lens '{lens}' has a table of zoom, and other programs' files have one focal length")
    model, faults = document.validate(LensModel, lenses[lens], ("lenses", lens))
    if model is None:
        raise ConfigError(faults)
    text = write_lens(model, lens, how)
    if out is None:
        typer.echo(text, nl=False)
    else:
        write(out, text)
        note(f"written: {out}")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if found is None:
        raise InputError(f"--size-px is WIDTHxHEIGHT, as in 1280x720, not '{text}'")
    return int(found[1]), int(found[2])


def _entry(lens: LensModel) -> dict[str, object]:
    return {key: value for key, value in lens_entry(lens.build(), lens.distortion).items() if key != "r_max"}


def into_file(out: Path, name: str, entry: Mapping[str, Any], zoom_position: float | None = None) -> None:
    """Put a lens into a file of lenses, and say if it replaces one of another kind."""
    if replaced := put_lens(out, name, entry, zoom_position):
        note(f"'{name}' in {out} was a {replaced}, and is replaced")


def _check(config: Path | None, camera: str | None, *, write_rig: bool) -> None:
    """Raise InputError where the rig has no such camera, or what --write needs is not given."""
    if write_rig and (config is None or camera is None):
        raise InputError("--write needs the rig's file and the camera, as in import lens.yml rig.yaml north")
    if config is not None:
        rig = load_rig(config).rig
        if camera is not None and camera not in rig.cameras:
            raise InputError(f"rig '{rig.name}' has no camera '{camera}'; it has {', '.join(rig.cameras)}")


def _put(config: Path, camera: str, lenses: dict[str, LensModel]) -> None:
    if len(lenses) != 1:
        raise InputError(f"the file has {len(lenses)} lenses ({', '.join(lenses)}): write it with --out, and take one")
    (lens,) = lenses.values()
    changes = lens_changes(load_document(config), camera, lens_entry(lens.build(), lens.distortion), None)
    amend_rig(config, changes)
    note(f"written: {config}")
    if ("cameras", camera, "lens_sigma") in changes:
        note(f"{camera}'s lens_sigma was of its former lens, and is the usual one now: the file does not say its own")
