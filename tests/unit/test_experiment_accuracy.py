"""What ``accuracy`` makes of its tracks."""

from __future__ import annotations

import numpy as np
import pytest

from camrig.experiments.accuracy import CASES, Track, jobs
from camrig.experiments.accuracy_report import Report, as_json, as_markdown, rows


def track(case: str, seed: int, error_m: float | None, nees: float | None) -> Track:
    return Track(case, seed, "t1", 0 if error_m is None else 9, 10, error_m, error_m, nees)


def test_rows_are_means_of_what_was_published() -> None:
    found = rows([track("a", 0, 0.001, 2.0), track("a", 1, 0.003, 4.0), track("b", 0, None, None)])
    assert [(row.case, row.n) for row in found] == [("a", 2), ("b", 1)]
    assert found[0].published == 0.9
    assert found[0].mean_mm is not None
    assert (found[0].mean_mm.value, found[0].mean_mm.low, found[0].mean_mm.high) == pytest.approx((2.0, 1.0, 3.0))
    assert found[0].nees is not None
    assert found[0].nees.value == 3.0
    assert (found[1].published, found[1].mean_mm) == (0.0, None)
    report = Report(1, 0, "camrig experiment accuracy", {"cpu": "x", "cores": 1, "omp_num_threads": "1"}, {}, [])
    assert as_markdown(report).count("|--") == 6
    assert as_json(report)["rows"] == []


def test_every_case_has_a_name_and_a_key_of_its_own() -> None:
    every = list(jobs(2, 5))
    assert len({job.key for job in every}) == len(every) == 2 * len(CASES)
    assert len({case.name for case in CASES}) == len(CASES)
    assert np.unique([job.seed for job in every]).tolist() == [5, 6]
