"""A program of its own: a camera's job, or two in two threads, on painted pictures; prints pictures a second as JSON.

python -m tests.benchmarks.two_cameras THREADS PICTURES whole|windows
"""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import replace

import numpy as np

from camrig.clock import ManualClock
from camrig.detect import warm_up
from camrig.messages import Expected
from camrig.plugins import load_plugin
from camrig.runtime.camera_job import CameraJob
from camrig_emulators.fakes import FakeCamera
from tests.painted_room import Follower, exactly_seen, picture_at
from tests.simulated_room import LENS

FPS = 30.0


def expected_for_long() -> Expected:
    """Return the windows of the first second, held for ever."""
    follower, rng, told = Follower(), np.random.default_rng(1), None
    for number in range(30):
        _, news = follower.take(exactly_seen(number / FPS, number, rng), number / FPS + 0.02)
        told = next(iter(news), None) if news else told
    assert told is not None
    return replace(told, edges_px=np.tile(told.edges_px[:1], (3, 1, 1)), until_s=1e9)


def main() -> None:
    threads, pictures, kind = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    plugin, clock, image = (
        load_plugin("detectors", "pyapriltags"),
        ManualClock(),
        picture_at(1.0, np.random.default_rng(1)),
    )
    told = expected_for_long()
    warm_up()
    jobs = []
    for number in range(threads):
        camera = FakeCamera(f"c{number}", clock=clock)
        job = CameraJob(f"c{number}", camera, lambda: plugin.make(plugin.section(decimate=1.0)), clock, LENS)
        job.open()
        if kind == "windows":
            job.expected.put(told)
        jobs.append((job, camera))

    def work(job: CameraJob, camera: FakeCamera, count: int) -> None:
        for number in range(count):
            camera.push(image, told.from_s + 1.0 + 1e-3 * number)
            job.turn()

    for job, camera in jobs:
        work(job, camera, 3)
    print("ready", flush=True)
    sys.stdin.readline()
    workers = [threading.Thread(target=work, args=(job, camera, pictures)) for job, camera in jobs]
    begun_s = time.perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    took_s = time.perf_counter() - begun_s
    found = [len(job.detections.take_all()[-1].tags) for job, _ in jobs]
    print(json.dumps({"took_s": took_s, "found": found, "whole": [job.whole_frames for job, _ in jobs]}), flush=True)


if __name__ == "__main__":
    main()
