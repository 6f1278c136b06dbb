"""What a frame of the emulated world costs; ``pytest tests/benchmarks --benchmark-enable`` measures."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt
from camrig.geometry.pose import transform
from camrig.rig import Anchor, Body, BodyTag, Rig, Space, TagKey
from camrig_emulators.backdrop import Backdrop
from camrig_emulators.lens_rays import lens_rays
from camrig_emulators.renderer import Renderer, Sensor, Shot
from camrig_emulators.robots import RobotLimits, plan_motions
from camrig_emulators.scenery import Scenery
from camrig_emulators.sprites import painting_order


@pytest.mark.parametrize("turn_deg_s", [0.0, 10.0, 40.0])
def test_a_720p_frame_of_five_robots_and_three_anchors(benchmark: BenchmarkFixture, turn_deg_s: float) -> None:
    def at(x: float, y: float, z: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return transform(np.eye(3), np.array([x, y, z]))

    tags = {
        f"robot{k}": Body(f"robot{k}", (BodyTag(TagKey("tag36h11", k), 0.16, at(0.0, 0.0, 0.1)),)) for k in range(5)
    }
    places = ((1.0, 1.0), (5.0, 3.0), (3.0, 2.0))
    anchors = tuple(Anchor(TagKey("tag36h11", 100 + k), 0.2, at(x, y, 0.0)) for k, (x, y) in enumerate(places))
    rig = Rig("bench", Space(((0.0, 0.0), (6.0, 4.0))), {}, targets=tags, anchors=anchors)
    scenery = Scenery(rig, plan_motions(rig.targets, rig.space, RobotLimits(), 1))
    lens = BrownLens((1280, 720), (820.0, 820.0), (640.0, 360.0), (-0.33, 0.1, 0.0, 0.0, 0.0))
    head, optical = PanTilt(at(0.5, 0.5, 2.8)), transform(R_MOUNT_OPTICAL, np.zeros(3))
    rays = lens_rays(lens)
    renderer = Renderer(rays, Backdrop(rays), Sensor(), 1)

    def shot(stamp_s: float) -> Shot:
        T = head.T_world_camera(0.5 + math.radians(turn_deg_s) * stamp_s, -0.8, optical)
        return Shot(T, painting_order(scenery.anchors, scenery.robots(stamp_s), (), (), T[:3, 3]))

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        image = benchmark(renderer.render, shot, 0.0, 0)
    finally:
        cv2.setNumThreads(threads)
    assert image.shape == (720, 1280)
