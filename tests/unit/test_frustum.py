"""Footprints on the floor: what lies in one is in the picture, and the other way round."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from camrig.geometry import pose
from camrig.geometry.arrays import Array
from camrig.geometry.frustum import cone_directions, footprint, ray_floor, rays_footprint, rim_directions
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation

PINHOLE = BrownLens((640, 480), (500.0, 500.0), (319.5, 239.5))
LAB = BrownLens((1280, 800), (827.6785, 827.8561), (640.0, 400.0), (-0.335814, 0.101432, 0.0, 0.0, 0.0))


def looking(pan_deg: float, tilt_deg: float, height_m: float = 2.5) -> Array:
    R = aim_rotation(math.radians(pan_deg), math.radians(tilt_deg)) @ R_MOUNT_OPTICAL
    return pose.transform(R, np.array([1.0, 2.0, height_m]))


def test_a_pinhole_straight_down_sees_a_rectangle() -> None:
    polygon = footprint(PINHOLE, looking(0.0, -90.0), per_edge=1)
    # Image up is the pan direction, world x, so image right is world -y.
    half_x, half_y = 2.5 * 240.0 / 500.0, 2.5 * 320.0 / 500.0
    expected = [
        (1.0 + half_x, 2.0 + half_y),
        (1.0 + half_x, 2.0 - half_y),
        (1.0 - half_x, 2.0 - half_y),
        (1.0 - half_x, 2.0 + half_y),
    ]
    assert polygon == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize(("pan_deg", "tilt_deg"), [(30.0, -60.0), (-120.0, -45.0), (10.0, -88.0)])
def test_floor_points_are_in_the_footprint_exactly_when_they_are_in_the_picture(
    pan_deg: float, tilt_deg: float
) -> None:
    T = looking(pan_deg, tilt_deg)
    polygon = footprint(LAB, T, per_edge=64, max_range_m=100.0).astype(np.float32)
    rng = np.random.default_rng(0)
    floor = np.concatenate([rng.uniform(-4.0, 7.0, (2000, 2)), np.zeros((2000, 1))], axis=1)
    pixels = LAB.project(pose.apply(pose.invert(T), floor))
    edge = np.minimum(pixels + 0.5, np.array(LAB.size_px) - 0.5 - pixels).min(axis=1)
    inside = np.array([cv2.pointPolygonTest(polygon, (float(x), float(y)), measureDist=False) > 0 for x, y, _ in floor])
    clear = ~(np.abs(edge) < 2.0)  # the polygon cuts curved edges short by about a pixel
    assert inside.sum() > 50
    assert np.array_equal(inside[clear], (edge > 0.0)[clear])


def test_a_cones_footprint_is_the_ellipse_at_its_angle() -> None:
    alpha_rad = math.radians(25.0)
    T = looking(30.0, -50.0)
    polygon = rays_footprint(cone_directions(alpha_rad, 90), T, 0.3, 50.0)
    assert polygon.shape == (90, 2)
    rays = np.column_stack([polygon, np.full(90, 0.3)]) - T[:3, 3]
    off_axis = np.arccos(rays @ T[:3, 2] / np.linalg.norm(rays, axis=1))
    assert off_axis == pytest.approx(np.full(90, alpha_rad))
    below = rays_footprint(cone_directions(alpha_rad, 8), looking(0.0, -90.0), 0.0, 50.0)
    assert np.linalg.norm(below - [1.0, 2.0], axis=1) == pytest.approx(np.full(8, 2.5 * math.tan(alpha_rad)))


def test_past_the_horizon_the_footprint_ends_at_the_range() -> None:
    polygon = footprint(PINHOLE, looking(90.0, -5.0), max_range_m=8.0)
    reach = np.linalg.norm(polygon - [1.0, 2.0], axis=1)
    assert reach.max() == pytest.approx(8.0)
    assert reach.min() < 8.0
    assert (polygon[:, 1] > 2.0).all()


def test_a_camera_that_looks_up_sees_no_floor() -> None:
    assert footprint(PINHOLE, looking(0.0, 50.0)).shape == (0, 2)


def test_the_rim_ends_at_r_max() -> None:
    lens = BrownLens((1280, 800), (800.0, 800.0), (640.0, 400.0), r_max=0.3)
    rays = rim_directions(lens)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    assert np.linalg.norm(rays[:, :2] / rays[:, 2:], axis=1) == pytest.approx(0.3, abs=1e-6)


def test_rays_meet_the_floor_ahead_or_nowhere() -> None:
    origin = np.array([0.0, 0.0, 2.0])
    directions = np.array([[1.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    hits = ray_floor(origin, directions, floor_z_m=0.5)
    assert hits[0] == pytest.approx([1.5, 0.0, 0.5])
    assert np.isnan(hits[1:]).all()
