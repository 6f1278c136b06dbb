"""How fast this computer finds tags: the installed detector on a picture as full as a busy room's."""

from __future__ import annotations

import statistics
import time

import numpy as np

from camrig import plugins
from camrig.geometry.arrays import GreyImage
from camrig.host.findings import Finding
from camrig.messages import Verdict

SIZE_PX = (1280, 720)
DETECTOR = "pyapriltags"
_PICTURES = 5
_SQUARES = 40
_BLOTCH_PX, _BLOTCH_GREY, _NOISE_GREY = 20, 8.0, 0.7
"""The detector takes as long for it as for the median of some photographs of rooms with tags (40 ms where those do)."""
_CELLS, _CELL_PX = 10, 7
_GOOD_FPS, _LEAST_FPS = 15.0, 5.0


def busy_picture(seed: int = 1) -> GreyImage:
    """Draw squares of random cells with black borders on a blotched ground: quads for the detector to weigh."""
    random = np.random.default_rng(seed)
    width, height = SIZE_PX
    blotches = random.normal(180.0, _BLOTCH_GREY, (height // _BLOTCH_PX, width // _BLOTCH_PX))
    ground = np.kron(blotches, np.ones((_BLOTCH_PX, _BLOTCH_PX))) + random.normal(0.0, _NOISE_GREY, (height, width))
    side = _CELLS * _CELL_PX
    for _ in range(_SQUARES):
        cells = random.integers(0, 2, (_CELLS, _CELLS)) * 200 + 20
        cells[[0, -1], :] = cells[:, [0, -1]] = 20
        top, left = random.integers(0, height - side), random.integers(0, width - side)
        ground[top : top + side, left : left + side] = np.kron(cells, np.ones((_CELL_PX, _CELL_PX)))
    return np.clip(ground, 0, 255).astype(np.uint8)


def check_detection(cores: int) -> Finding:
    """Time the detector on one core; a camera's thread keeps one busy. Raises InputError where it is not installed."""
    plugin = plugins.load_plugin("detectors", DETECTOR)
    detector, picture = plugin.make(plugin.section()), busy_picture()
    detector.detect(picture)
    times_s = []
    for _ in range(_PICTURES):
        begun_s = time.perf_counter()
        detector.detect(picture)
        times_s.append(time.perf_counter() - begun_s)
    fps = 1.0 / statistics.median(times_s)
    width, height = SIZE_PX
    says = f"{fps:.0f} pictures of {width}x{height} a second a core, {cores} cores: {DETECTOR} on a busy picture"
    if fps >= _GOOD_FPS:
        return Finding("detection", Verdict.GREEN, says)
    health = Verdict.AMBER if fps >= _LEAST_FPS else Verdict.RED
    return Finding(
        "detection", health, says, "set `decimate: 2.0` in `detector:`, or use smaller pictures or a faster CPU"
    )
