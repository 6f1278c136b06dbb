"""A rig of eight cameras calibrated from a board of 60 tags at 200 instants: time, memory, and how they grow.

Run by ``pytest tests/benchmarks/test_calibrate_speed.py --benchmark-enable -m slow``.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig.calibrate.adjust import adjust
from camrig.calibrate.chains import Chains, points_in_camera
from camrig.calibrate.extrinsics import extrinsics
from camrig.calibrate.normal import TagViews
from camrig.calibrate.setup import Setup
from camrig.calibrate.sighted import Shot
from camrig.geometry.arrays import Array
from camrig.geometry.lens import BrownLens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import perturb, transform
from camrig.geometry.rotation import rotation_exp, rotation_x
from tests.benchmarks.memory import peak_mib

LENS = BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
CAMERAS, TAGS, SIZE_M, NOISE_PX = 8, 60, 0.1, 0.2
MOST_S, MOST_BYTES = 20.0, 2**30
MOST_GROWTH = 1.5
"""Of seconds per view, from 50 to 200 instants: near-linear. Measured: 0.9."""


def scene(instants: int, seed: int = 0) -> tuple[TagViews, Array]:
    """All that eight cameras could see of the board, and all poses: cameras, the board by instant, tags."""
    rng = np.random.default_rng(seed)
    cameras = [
        transform(
            rotation_x(np.pi) @ rotation_exp(rng.normal(size=3) * 0.1), np.array([0.4 * (k % 4), 0.5 * (k // 4), 2.5])
        )
        for k in range(CAMERAS)
    ]
    lift = transform(np.eye(3), np.array([0.6, 0.25, 0.0]))
    boards = [perturb(lift, rng.normal(size=6) * [0.15, 0.15, 0.2, 0.2, 0.2, 1.0]) for _ in range(instants)]
    tags = [transform(np.eye(3), np.array([0.12 * (k % 10) - 0.55, 0.12 * (k // 10) - 0.3, 0.0])) for k in range(TAGS)]
    T = np.stack([*cameras, *boards, *tags])
    camera, instant, tag = (at.ravel() for at in np.indices((CAMERAS, instants, TAGS)))
    chains = Chains(camera[:, None], np.stack([CAMERAS + instant, CAMERAS + instants + tag], axis=1))
    corners = np.tile(SIZE_M * TAG_CORNERS, (len(camera), 1, 1))
    pixels = LENS.project(points_in_camera(T, chains, corners))
    seen = np.asarray(np.isfinite(pixels).all(axis=(1, 2)))
    pixels += rng.normal(size=pixels.shape) * NOISE_PX
    return TagViews(camera, chains, corners, pixels, np.full((len(camera), 4), NOISE_PX)).only(seen), T


def adjusted_s(instants: int) -> tuple[float, int, float]:
    """Return the processor's seconds, the views, and the rms in pixels; the start is a centimetre off."""
    views, T = scene(instants)
    rng = np.random.default_rng(1)
    held = np.zeros(len(T), dtype=bool)
    held[[0, CAMERAS + instants]] = True
    start = np.stack(
        [pose if still else perturb(pose, rng.normal(size=6) * 0.01) for pose, still in zip(T, held, strict=True)]
    )
    begun_s = time.process_time()
    found = adjust(views, [LENS] * CAMERAS, start, held)
    return time.process_time() - begun_s, len(views.lens), found.rms_px


@pytest.mark.slow
def test_eight_cameras_sixty_tags_two_hundred_instants(benchmark: BenchmarkFixture) -> None:
    """The bar: 20 s and 1 GiB, near-linear in the observations; 96 000 views of tags, 768 000 numbers."""
    adjusted_s(2)  # loads and compiles
    few = [adjusted_s(50) for _ in range(2)]
    many = [adjusted_s(200) for _ in range(2)]
    benchmark.pedantic(adjusted_s, args=(200,), rounds=1)  # type: ignore[no-untyped-call]
    per_view = [min(s / views for s, views, _ in of) for of in (few, many)]
    benchmark.extra_info |= {"views": many[0][1], "growth": per_view[1] / per_view[0]}
    assert many[0][1] > 0.9 * CAMERAS * TAGS * 200
    assert min(s for s, _, _ in many) < MOST_S
    assert peak_mib() * 2**20 < MOST_BYTES
    assert per_view[1] < MOST_GROWTH * per_view[0]
    assert many[0][2] == pytest.approx(NOISE_PX * np.sqrt(2.0), rel=0.02)


@pytest.mark.slow
def test_the_same_from_nothing(benchmark: BenchmarkFixture) -> None:
    """Corners alone given: everything is placed one by one, then adjusted thrice."""
    views, _ = scene(200)
    shots: dict[tuple[int, int], dict[str, Array]] = {}
    for camera, (board, tag), pixels in zip(views.lens, views.chains.tag, views.pixels, strict=True):
        shots.setdefault((int(camera), int(board)), {})[f"t{tag}"] = pixels
    all_shots = [Shot(f"cam{camera}", instant, corners) for (camera, instant), corners in shots.items()]
    sizes = dict.fromkeys({tag for shot in all_shots for tag in shot.corners_px}, SIZE_M)
    setup = Setup({f"cam{k}": LENS for k in range(CAMERAS)}, sizes)
    found = benchmark.pedantic(extrinsics, args=(all_shots, setup), rounds=1)  # type: ignore[no-untyped-call]
    assert found.unplaced == ()
    assert found.noise_px == pytest.approx(NOISE_PX, rel=0.02)
