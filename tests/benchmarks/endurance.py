"""A program of its own: one camera's detections through the pipeline, for days of its time; memory's slope as JSON.

    python -m tests.benchmarks.endurance --frames 2600000

Robots at 30 frames a second; 2.6 million frames are a day of one camera, and take over two hours with five robots.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy import stats

from camrig.geometry.arrays import Array
from tests.painted_room import Follower, exactly_seen

FPS = 30.0
SETTLING = 0.1
"""The part of the run after which memory counts: caches fill, pools grow to what is needed."""
BLOCKS = 10
SAMPLES = 500


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def slope(hours: Array, megabytes: Array) -> tuple[float, float, float]:
    """Return the slope in MB/h, and its 95 % interval from the slopes of blocks."""
    parts = np.array_split(np.arange(len(hours)), BLOCKS)
    rises = [(megabytes[part[-1]] - megabytes[part[0]]) / (hours[part[-1]] - hours[part[0]]) for part in parts]
    half = float(stats.t.ppf(0.975, BLOCKS - 1) * np.std(rises, ddof=1) / np.sqrt(BLOCKS))
    overall = float((megabytes[-1] - megabytes[0]) / (hours[-1] - hours[0]))
    return overall, float(np.mean(rises)) - half, float(np.mean(rises)) + half


def main() -> None:
    parser = argparse.ArgumentParser(description="Memory of the pipeline over many frames.")
    parser.add_argument("--frames", type=int, default=2_600_000, help="frames of one camera [2600000]")
    parser.add_argument("--robots", type=int, choices=range(1, 6), default=5, help="how many are in view [5]")
    asked = parser.parse_args()
    rng, follower, samples, tracked = np.random.default_rng(1), Follower(), [], asked.robots
    begun_s, every = time.perf_counter(), max(1, asked.frames // SAMPLES)
    for number in track(range(asked.frames), "following", console=Console(stderr=True)):
        stamp_s = number / FPS
        seen = exactly_seen(stamp_s, number, rng)
        published, _ = follower.take(replace(seen, tags=seen.tags[: asked.robots]), stamp_s + 0.01)
        if number > 100:
            tracked = min(tracked, follower.tracked(published))
        if number % every == 0 and number >= SETTLING * asked.frames:
            samples.append((stamp_s / 3600.0, resident_mb()))
    hours, megabytes = np.array(samples).T
    overall, low, high = slope(hours, megabytes)
    print(
        json.dumps(
            {
                "frames": asked.frames,
                "robots": asked.robots,
                "hours_at_30_fps": round(asked.frames / FPS / 3600.0, 2),
                "tracked": tracked,
                "mb": round(float(megabytes[-1]), 1),
                "mb_per_hour": round(overall, 3),
                "interval_mb_per_hour": [round(low, 3), round(high, 3)],
                "run_s": round(time.perf_counter() - begun_s, 1),
            }
        )
    )


if __name__ == "__main__":
    main()
