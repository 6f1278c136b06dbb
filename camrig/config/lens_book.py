"""A file of lenses alone, as ``--out`` writes it: a lens is put in, and what else is there stays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from camrig.config.amend import amended
from camrig.config.document import KeyPath, load_document
from camrig.config.kept_file import write
from camrig.config.lens_entry import with_zoom_row
from camrig.errors import InputError


def lens_text(lenses: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the file of some lenses."""
    plain = {name: dict(lens) for name, lens in lenses.items()}
    return yaml.safe_dump({"lenses": plain}, sort_keys=False, default_flow_style=None, width=120)


def check_place(path: Path, name: str, *, zoom: bool) -> None:
    """Ask before a long job whether a lens, or a row of its ``zoom``, can be put into a file.

    Raises InputError where the file is no file of lenses, and where the lens of that name there is of the other kind.
    """
    _there(path, name, zoom=zoom)


def put_lens(path: Path, name: str, entry: Mapping[str, Any], zoom_position: float | None = None) -> str:
    """Put a lens, or its row at a position of its zoom, into a file, which is made if need be; return what lens of
    another kind it replaced, in words, or nothing.

    Of a lens that is replaced ``readout_s`` stays, and so does all else in the file. Raises InputError as
    ``check_place`` does, and where rows of zoom are of another model or size.
    """
    there = _there(path, name, zoom=zoom_position is not None)
    section = dict(entry) if zoom_position is None else with_zoom_row(there, zoom_position, entry)
    if not path.exists():
        write(path, lens_text({name: section}))
        return ""
    changes: dict[KeyPath, object] = {("lenses", name): section}
    if there:
        changes = {("lenses", name, key): value for key, value in section.items() if there.get(key) != value}
    write(path, amended(load_document(path).text, changes))
    return _kind(there) if there and _kind(there) != _kind(section) else ""


def _kind(lens: Mapping[str, Any]) -> str:
    size = lens.get("size_px")
    return f"{lens.get('model', 'brown')} lens for {'x'.join(map(str, size)) if isinstance(size, list) else size} px"


def _there(path: Path, name: str, *, zoom: bool) -> Mapping[str, Any]:
    """Return the lens that a file has under a name, empty where it has none."""
    lenses = (load_document(path).data.get("lenses") or {}) if path.exists() else {}
    lens = (lenses.get(name) or {}) if isinstance(lenses, dict) else None
    if not isinstance(lens, dict):
        raise InputError(f"{path} is there, and is no file of lenses (lenses: {{{name}: ...}}): name another file")
    if not lens:
        return lens
    if zoom != ("zoom" in lens):
        kind, what = ("a table of zoom", "give --zoom-position") if not zoom else ("one focal length", "leave it")
        raise InputError(f"lens '{name}' in {path} has {kind}: {what}, or name another file")
    rows = lens.get("zoom", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) and _is_number(row.get("position")) for row in rows):
        raise InputError(f"lens '{name}' in {path}: zoom is a list of rows, each with its position; mend it first")
    return lens


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
