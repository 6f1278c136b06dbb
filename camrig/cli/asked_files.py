"""The files that a command is asked to write: looked at before its work, so that no result is lost to a bad name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from camrig.config.kept_file import check_writable, former, replace
from camrig.errors import InputError
from camrig.report.calibration import CalibrationReport, report_html


def check_files(outputs: Mapping[str, Path | None], *read: Path | None) -> None:
    """Look at files to write, by their options, and at those that the command reads.

    Raises InputError for one that would overwrite what is read, its kept version, or another one's, and for one that
    cannot be written.
    """
    taken: dict[Path, str] = {}
    for path in read:
        if path is not None:
            taken[path.resolve()] = f"would overwrite {path}, which is read"
            taken[former(path.resolve())] = f"would overwrite the version of {path} that is kept"
    for option, path in outputs.items():
        if path is None:
            continue
        if why := taken.get(path.resolve()):
            raise InputError(f"{option} {path} {why}: name another file")
        taken[path.resolve()] = f"is the file of {option} too"
        try:
            check_writable(path)
        except InputError as error:
            raise InputError(f"{option}: {error}") from error


def write_report(path: Path, report: CalibrationReport) -> None:
    """Write a page whole or not at all; raises InputError where the file cannot be written."""
    replace(path, report_html(report).encode())


@contextmanager
def collected(faults: list[str]) -> Iterator[None]:
    """Take what is refused inside into ``faults`` instead: one file does not cost the others, or the answer."""
    try:
        yield
    except InputError as error:
        faults.append(str(error))
