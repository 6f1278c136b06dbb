"""What a grey picture costs, beside the least that it could: a copy of as many bytes, or OpenCV's own decoding.

A device has just written its buffer: before each measurement, of ours and of the other, the caches are swept. The
plain copy goes into an array as numpy makes it; what it takes into our picture's memory is reported beside that.
"""

from __future__ import annotations

import mmap
import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig_drivers.v4l2.grey import PixelFormat, decode_jpeg, empty_picture, luma_layout

SIZE_PX = (1280, 720)
ROUNDS, PAIRS = 5, 30
BUFFERS = 4
SWEEP = np.zeros(1 << 25, np.uint8)


def paired_ratio(ours: Callable[[int], object], other: Callable[[int], object], *, swept: bool) -> float:
    """Return the ratio of the two's fastest tenths, the median of some rounds."""
    return statistics.median(_round(ours, other, swept=swept) for _ in range(ROUNDS))


def _round(ours: Callable[[int], object], other: Callable[[int], object], *, swept: bool) -> float:
    """Run both side by side on the same buffers, taking turns to begin; time is this thread's own."""
    times_s: dict[Callable[[int], object], list[float]] = {ours: [], other: []}
    for pair in range(PAIRS):
        for work in (ours, other) if pair // BUFFERS % 2 else (other, ours):
            if swept:
                SWEEP[::64] += 1
            begun_s = time.thread_time()
            work(pair % BUFFERS)
            times_s[work].append(time.thread_time() - begun_s)
    fast_ours_s, fast_other_s = (statistics.quantiles(times_s[work], n=10)[0] for work in (ours, other))
    return fast_ours_s / fast_other_s


@pytest.mark.parametrize("pixels", ["YUYV", "NV12"])
def test_a_grey_picture_costs_at_most_half_more_than_a_copy_of_its_luma(
    benchmark: BenchmarkFixture, pixels: PixelFormat
) -> None:
    width, height = SIZE_PX
    layout = luma_layout(pixels, SIZE_PX, 0)
    assert layout is not None
    buffers = [mmap.mmap(-1, 2 * width * height) for _ in range(BUFFERS)]
    lumas = [layout.view(buffer) for buffer in buffers]
    planes = [np.frombuffer(buffer, np.uint8, width * height).reshape(height, width) for buffer in buffers]
    image, plain = empty_picture(SIZE_PX), np.empty((height, width), np.uint8)
    for luma in lumas:
        luma[:] = np.random.default_rng(1).integers(0, 256, luma.shape, np.uint8)

    def ours(index: int) -> None:
        layout.copy(lumas[index], image)

    def other(index: int) -> None:
        np.copyto(plain, planes[index])

    def same(index: int) -> None:
        np.copyto(image, planes[index])

    ratio = paired_ratio(ours, other, swept=True)
    benchmark.extra_info.update(
        ratio=ratio,
        ratio_within_the_cache=paired_ratio(ours, other, swept=False),
        ratio_into_the_same_memory=paired_ratio(ours, same, swept=True),
    )
    benchmark(layout.copy, lumas[0], image)
    assert benchmark.disabled or ratio <= 1.5


def test_a_jpeg_costs_no_more_than_opencvs_decoding_to_grey(benchmark: BenchmarkFixture) -> None:
    random = np.random.default_rng(1)
    noise = cv2.GaussianBlur(random.integers(0, 256, (SIZE_PX[1], SIZE_PX[0], 3), np.uint8), (0, 0), 4.0)
    data = bytes(cv2.imencode(".jpg", cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX))[1])  # type: ignore[call-overload]
    buffers = [mmap.mmap(-1, 1 << 20) for _ in range(BUFFERS)]
    for buffer in buffers:
        buffer[: len(data)] = data
    whole = [np.frombuffer(buffer, np.uint8, len(data)) for buffer in buffers]
    ratio = paired_ratio(
        lambda index: decode_jpeg(buffers[index], len(data), SIZE_PX),
        lambda index: cv2.imdecode(whole[index], cv2.IMREAD_GRAYSCALE),
        swept=False,
    )
    benchmark.extra_info["ratio"] = ratio
    benchmark(decode_jpeg, buffers[0], len(data), SIZE_PX)
    assert benchmark.disabled or ratio <= 1.03, "no slower, but for the clock's noise"
