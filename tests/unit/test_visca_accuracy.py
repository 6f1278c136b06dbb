"""A VISCA head's pose at a frame's stamp against the emulated truth, while it moves and at rest."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from camrig.locate import HeadHistory
from tests.pelco_d_accuracy import Frames
from tests.visca_bench import ViscaBench


def random_moves(baud: int, count: int, seed: int) -> Frames:
    """Move ``count`` times and judge one frame of each move, as soon as both axes have a reading after it."""
    bench = ViscaBench(seed=seed, baud=baud, rest_error_deg=0.0375, readback_sigma_deg=0.0)
    rng, history = random.Random(seed), HeadHistory()
    errors, sigmas, moving = [], [], []
    bench.head.open()
    bench.head.enable()
    for _ in range(count):
        bench.head.move_to(math.radians(rng.uniform(-80.0, 80.0)), math.radians(rng.uniform(-80.0, 0.0)))
        begun_s = bench.clock.now_s()
        stamp_s, judged = begun_s + rng.uniform(0.0, 4.0), False
        while bench.clock.now_s() < begun_s + 4.5:
            for reading in bench.head.read(0.3):
                history = history.with_reading(reading)
            if not judged and history.covers(stamp_s):
                state, judged = history.at(stamp_s), True
                assert state is not None
                true_rad, before_rad = (np.array(bench.truth_rad(s)) for s in (stamp_s, stamp_s - 0.01))
                errors.append(state.angles_rad - true_rad)
                sigmas.append(np.sqrt(np.diag(state.covariance)))
                moving.append(bool(np.abs(true_rad - before_rad).max() > 1e-6))
    bench.head.close()
    return Frames(np.array(errors), np.array(sigmas), np.array(moving), count - len(errors))


def judged(frames: Frames, name: str, least: float) -> None:
    low, high = frames.nees_interval
    print(
        f"{name}: n {len(frames.moving)}, unknown {frames.unknown}, within 3 sigma {frames.within_3_sigma:.4f}, "
        f"NEES {frames.nees:.3f} ({low:.2f}..{high:.2f}), p95 moving {frames.of(moving=True).p95_deg():.3f} deg"
    )
    assert frames.unknown == 0
    assert frames.within_3_sigma >= least
    assert low <= frames.nees <= high


def test_sixty_random_moves() -> None:
    judged(random_moves(9600, 60, seed=5), "9600", 0.98)


@pytest.mark.slow
@pytest.mark.parametrize("baud", [9600, 38400])
def test_a_thousand_random_moves(baud: int) -> None:
    judged(random_moves(baud, 1000, seed=11), str(baud), 0.99)
