"""The tracks of ``accuracy`` -> figures by case; JSON and Markdown. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from camrig.experiments.accuracy import BODIES, HEADS, SCORED_FROM_S, UNTIL_S, Track
from camrig.experiments.machine import in_words
from camrig.experiments.statistics import Ranged, mean_of_groups


@dataclass(frozen=True, slots=True)
class Row:
    """One case over n bodies: means in millimetres with their intervals, and how often bodies were published."""

    case: str
    n: int
    published: float
    mean_mm: Ranged | None
    floor_mm: Ranged | None
    nees: Ranged | None


@dataclass(frozen=True, slots=True)
class Report:
    """All that a run is told by."""

    rooms: int
    seed: int
    command: str
    machine: Mapping[str, object]
    versions: Mapping[str, str]
    tracks: Sequence[Track]


def rows(tracks: Sequence[Track]) -> list[Row]:
    """Return the figures of every case; rooms are drawn again for the intervals."""
    found = []
    for case in dict.fromkeys(track.case for track in tracks):
        own = [track for track in tracks if track.case == case]
        groups = [[track for track in own if track.seed == seed] for seed in dict.fromkeys(track.seed for track in own)]

        def mean(key: str, scale: float, groups: list[list[Track]] = groups) -> Ranged | None:
            values = [[getattr(track, key) for track in group] for group in groups]
            return mean_of_groups([scale * np.array([x for x in each if x is not None], float) for each in values])

        share = sum(track.published for track in own) / sum(track.possible for track in own)
        found.append(Row(case, len(own), share, mean("error_m", 1e3), mean("floor_m", 1e3), mean("nees", 1.0)))
    return found


def as_json(report: Report) -> dict[str, object]:
    """Return the whole report, down to every body. Only ``machine`` differs between two equal runs."""
    return {
        "experiment": "accuracy",
        "command": report.command,
        "rooms": report.rooms,
        "seed": report.seed,
        "versions": dict(report.versions),
        "rows": [asdict(row) for row in rows(report.tracks)],
        "tracks": [asdict(track) for track in report.tracks],
        "machine": dict(report.machine),
    }


def as_markdown(report: Report) -> str:
    """Return the table with its caption and the command that makes it again."""
    lines = [
        _caption(report),
        "",
        "| case | n | published | error, mm [95 %] | on the floor, mm [95 %] | NEES [95 %] |",
        "|--" * 6 + "|",
    ]
    lines += [
        f"| {row.case} | {row.n} | {row.published:.1%} | {_ranged(row.mean_mm)} | {_ranged(row.floor_mm)} "
        f"| {_ranged(row.nees)} |"
        for row in rows(report.tracks)
    ]
    return "\n".join(lines) + "\n"


def _caption(report: Report) -> str:
    return (
        f"**{report.rooms} rooms a case** (seeds {report.seed} to {report.seed + report.rooms - 1}): {HEADS} heads as "
        f"camrig plans them, {BODIES} bodies, five pictures a second each, positions from {SCORED_FROM_S:g} s to "
        f"{UNTIL_S:g} s after the first picture. Each case differs from the base in what it names. NEES is 3 where the "
        "covariance is right, below where it is cautious.\n"
        f"{in_words(report.machine, report.versions)}\n\n```sh\n{report.command}\n```"
    )


def _ranged(found: Ranged | None) -> str:
    return "" if found is None else f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"
