"""Results on disk as they come, a line of JSON each, so that an experiment that was interrupted goes on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from camrig.errors import InputError


class Kept:
    """The results of one experiment by the keys of its jobs; without a file they are only remembered."""

    def __init__(self, path: Path | None, made_by: str) -> None:
        """Read what the file holds. ``made_by`` says what results depend on beside their keys: those of another kind
        are not mixed with. Raises InputError for a file that holds something else, or cannot be read or written.
        """
        self._path = path
        self._results: dict[str, Any] = {}
        if path is None:
            return
        try:
            self._open(path, made_by)
        except OSError as error:
            raise InputError(f"{path}: results cannot be kept here: {error.strerror}") from error

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def add(self, key: str, result: Any) -> None:
        """Keep a result, which must be as JSON has it. Raises InputError where it cannot be written."""
        self._results[key] = result
        if self._path is None:
            return
        try:
            _append(self._path, {"job": key, "result": result})
        except OSError as error:
            raise InputError(f"{self._path}: results cannot be kept here: {error.strerror}") from error

    def _open(self, path: Path, made_by: str) -> None:
        text = path.read_text() if path.exists() else ""
        lines = text.splitlines()
        if not lines:
            path.write_text(json.dumps({"made_by": made_by}) + "\n")
            return
        whole = lines if text.endswith("\n") else lines[:-1]  # the last one was being written when all ended
        try:
            head, *records = (json.loads(line) for line in whole)
            theirs = head["made_by"]
            self._results = {record["job"]: record["result"] for record in records}
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(f"{path} holds no results of an experiment; move it away") from error
        if theirs != made_by:
            raise InputError(
                f"{path} holds results of {theirs}, not of {made_by}; move it away, or name another folder"
            )
        if len(whole) < len(lines):
            path.write_text("".join(f"{line}\n" for line in whole))


def _append(path: Path, record: dict[str, Any]) -> None:
    with path.open("a") as file:
        file.write(json.dumps(record, allow_nan=False) + "\n")
