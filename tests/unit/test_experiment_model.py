"""What models promise of sightings, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from camrig.experiments.model import CORNERS, QUALITIES, Job, Sighted, work
from camrig.experiments.model_report import bounds, predictions


def sighted(seed: int, promised_m: float, error_m: float) -> Sighted:
    promised = {corners: dict.fromkeys(QUALITIES, promised_m) for corners in CORNERS}
    errors = {corners: [error_m, 0.0, 0.0] for corners in CORNERS}
    return Sighted("ptz", seed, f"t{promised_m}", promised, errors, [1e3 * promised_m, 0.0, 0.0])


def test_errors_that_grow_as_the_square_of_what_was_promised_have_slope_two() -> None:
    rng = np.random.default_rng(1)
    found = [sighted(seed, q, 100.0 * q * q) for seed in range(6) for q in rng.uniform(0.001, 0.02, 8)]
    for each in predictions(found):
        assert each.n == 48
        assert each.spearman.value == pytest.approx(1.0)
        assert (each.slope.value, each.slope.low, each.slope.high) == pytest.approx((2.0, 2.0, 2.0))
    assert len(predictions(found)) == len(CORNERS) * len(QUALITIES)


def test_bounds_are_counted_over_targets_and_over_the_lengths_between_them() -> None:
    held, broken = sighted(0, 0.002, 0.001), sighted(0, 0.003, 0.0091)  # 8.1 mm too long, 6 mm allowed
    for each in bounds([held, broken]):
        assert (each.n, each.error_below_q.value) == (2, 0.5)
        assert (each.lengths, each.length_below_2q.value) == (1, 0.0)


def test_a_picture_is_promised_something_by_every_model_and_the_same_again() -> None:
    found = work(Job("drone", 3))
    assert found == work(Job("drone", 3))
    assert len(found) >= 3
    for each in found:
        for corners in CORNERS:
            assert set(each["promised_m"][corners]) == set(QUALITIES)
            assert np.linalg.norm(each["error_m"][corners]) < 0.03
