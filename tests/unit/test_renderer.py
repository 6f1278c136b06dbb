"""Pictures are where OpenCV says, judged by the AprilTag detector: corners, order, blur, noise, occlusion."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pyapriltags
import pytest

from camrig.errors import InputError
from camrig.geometry.arrays import Array, GreyImage, Transform
from camrig.geometry.lens import BrownLens, FisheyeLens
from camrig.geometry.pan_tilt import R_BODY_OPTICAL_DOWN
from camrig.geometry.pose import apply, invert, transform
from camrig.geometry.rotation import rotation_exp, rotation_z
from camrig.rig import Anchor, Body, BodyTag, Box, Rig, Space, TagKey
from camrig_emulators.backdrop import Backdrop
from camrig_emulators.lens_rays import BORDER_PX, LensRays, lens_rays
from camrig_emulators.renderer import Renderer, Sensor, Shot
from camrig_emulators.robots import RobotLimits, plan_motions
from camrig_emulators.scenery import Scenery
from camrig_emulators.sprites import painting_order
from camrig_emulators.tag_pictures import tag_cells

AnyLens = BrownLens | FisheyeLens
BROWN = BrownLens((1280, 720), (820.0, 820.0), (640.0, 360.0), (-0.33, 0.1, 0.0, 0.0, 0.0))
FISHEYE = FisheyeLens((1280, 720), (420.0, 420.0), (650.0, 350.0), (-0.02, 0.004, 0.0, 0.0))
SIZE_M = 0.16
KEY = TagKey("tag36h11", 7)
QUIET = Sensor(exposure_s=0.004, noise_grey=0.0, psf_px=0.7)


@lru_cache
def rays_of(lens: AnyLens) -> LensRays:
    return lens_rays(lens)


@lru_cache
def renderer_of(lens: AnyLens, sensor: Sensor) -> Renderer:
    return Renderer(rays_of(lens), Backdrop(rays_of(lens)), sensor, seed=1)


@lru_cache
def detector(families: str = "tag36h11") -> pyapriltags.Detector:
    return pyapriltags.Detector(families=families, nthreads=1, quad_decimate=1.0)


def anchor_scene(*anchors: Anchor, keep_out: tuple[Box, ...] = (), targets: dict[str, Body] | None = None) -> Scenery:
    rig = Rig("room", Space(((-3.0, -2.0), (3.0, 2.0)), keep_out), {}, targets=targets or {}, anchors=tuple(anchors))
    return Scenery(rig, plan_motions(rig.targets, rig.space, RobotLimits(), 1))


def tag_at(position_m: tuple[float, float, float], yaw_rad: float = 0.0, key: TagKey = KEY) -> Anchor:
    return Anchor(key, SIZE_M, transform(rotation_z(yaw_rad), np.array(position_m)))


def render(
    scene: Scenery,
    pose_at: Callable[[float], Transform],
    sensor: Sensor = QUIET,
    lens: AnyLens = BROWN,
    sequence: int = 0,
) -> GreyImage:
    """Draw at stamp 0 with a camera at ``pose_at(stamp_s)``."""

    def shot(at_s: float) -> Shot:
        T = pose_at(at_s)
        order = painting_order(scene.anchors, scene.robots(at_s), scene.boxes, scene.box_limits_m, T[:3, 3])
        return Shot(T, order)

    return renderer_of(lens, sensor).render(shot, 0.0, sequence)


def looking_down(x_m: float, y_m: float, z_m: float, lean: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Transform:
    R = R_BODY_OPTICAL_DOWN @ rotation_exp(np.array(lean))
    return transform(R, np.array([x_m, y_m, z_m]))


def at(T_world_camera: Transform) -> Callable[[float], Transform]:
    """Return a camera that stays where it is."""
    return lambda _: T_world_camera


def true_corners(T_world_camera: Transform, anchor: Anchor, lens: AnyLens) -> Array:
    """Return p0..p3 of docs/frames-and-units.md by OpenCV's projection."""
    s = anchor.size_m / 2.0
    corners = np.array([[-s, -s, 0.0], [s, -s, 0.0], [s, s, 0.0], [-s, s, 0.0]])
    return rays_of(lens).project(apply(invert(T_world_camera) @ anchor.T_world_tag, corners))


def found_corners(image: GreyImage, tag_id: int = 7, families: str = "tag36h11") -> Array | None:
    found = [tag for tag in detector(families).detect(image) if tag.tag_id == tag_id]
    return np.asarray(found[0].corners) - 0.5 if found else None


@pytest.mark.parametrize(("lens", "height_m"), [(BROWN, (2.0, 3.0)), (FISHEYE, (1.5, 2.2))], ids=["brown", "fisheye"])
@pytest.mark.parametrize("noise_grey", [0.0, 3.5])
def test_corners_of_central_tags_are_where_the_lens_puts_them(
    lens: AnyLens, height_m: tuple[float, float], noise_grey: float
) -> None:
    rng = np.random.default_rng(1)
    errors = []
    for number in range(16):
        anchor = tag_at((0.0, 0.0, 0.0), rng.uniform(-3.0, 3.0))
        height = rng.uniform(*height_m)
        x, y = rng.uniform(-0.12, 0.12, 2) * height
        T = looking_down(x, y, height, (*rng.uniform(-0.15, 0.15, 2), 0.0))
        sensor = Sensor(exposure_s=0.004, noise_grey=noise_grey)
        corners = found_corners(render(anchor_scene(anchor), at(T), sensor, lens, sequence=number))
        assert corners is not None
        errors.append(corners - true_corners(T, anchor, lens))
    # Measured, seed 1, n = 16 tags: 0.025 to 0.033 px, the floor of the detector.
    assert np.sqrt(np.mean(np.square(errors))) < 0.05
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.02


@pytest.mark.parametrize("family", ["tag36h11", "tag25h9", "tag16h5"])
def test_corner_order_is_apriltags(family: str) -> None:
    key = TagKey(family, 3)
    anchor = tag_at((0.0, 0.0, 0.0), 0.4, key)
    T = looking_down(0.0, 0.0, 1.5)
    corners = found_corners(render(anchor_scene(anchor), at(T)), 3, family)
    assert corners is not None
    np.testing.assert_allclose(corners, true_corners(T, anchor, BROWN), atol=0.3)


@pytest.mark.parametrize("lens", [BROWN, FISHEYE], ids=["brown", "fisheye"])
def test_rays_agree_with_the_lens_of_geometry(lens: AnyLens) -> None:
    rays = rays_of(lens)
    rows, columns = np.mgrid[0:720:37, 0:1280:41]
    ideal = lens.unproject(np.stack([columns, rows], axis=-1).astype(float))
    table = rays.ideal[rows + BORDER_PX, columns + BORDER_PX]
    if rays.dark is None:
        np.testing.assert_allclose(table, ideal, rtol=1e-6, atol=1e-6)
    else:
        lit = ~rays.dark[rows, columns]
        np.testing.assert_allclose(table[lit], ideal[lit], rtol=1e-5, atol=1e-5)


def test_past_r_max_the_picture_is_dark() -> None:
    lens = BrownLens((1280, 720), (820.0, 820.0), (640.0, 360.0), (-0.33, 0.1, 0.0, 0.0, 0.0), r_max=0.8)
    image = render(anchor_scene(), at(looking_down(0.0, 0.0, 2.0)), lens=lens)
    assert image[0, 0] == 0
    assert image[360, 640] > 80


def test_tags_behind_turned_away_or_outside_leave_the_floor_bare() -> None:
    empty = render(anchor_scene(), at(looking_down(0.0, 0.0, 2.0)))
    behind = tag_at((0.0, 0.0, 3.0))
    from_below = Anchor(KEY, SIZE_M, transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.5])))
    outside = tag_at((9.0, 0.0, 0.0))
    for anchor in (behind, from_below, outside):
        np.testing.assert_array_equal(render(anchor_scene(anchor), at(looking_down(0.0, 0.0, 2.0))), empty)


def test_a_tag_cut_by_the_edge_is_drawn_up_to_the_edge() -> None:
    anchor = tag_at((0.0, 0.0, 0.0))
    rays = rays_of(BROWN)
    x_m = 2.0 * float(rays.ideal[360 + BORDER_PX, BORDER_PX, 0])
    image = render(anchor_scene(anchor), at(looking_down(-x_m, 0.0, 2.0)))
    left = image[350:371, :24]
    assert left.min() < 60
    assert left.max() > 180


def test_noise_has_its_sigma_is_white_and_new_in_every_frame() -> None:
    scene, pose = anchor_scene(), looking_down(0.0, 0.0, 2.0)
    clean = render(scene, at(pose)).astype(float)
    noise = [render(scene, at(pose), Sensor(noise_grey=3.5), sequence=k).astype(float) - clean for k in (0, 1)]
    assert np.std(noise[0]) == pytest.approx(np.hypot(3.5, 12.0**-0.5), rel=0.02)
    assert abs(np.mean(noise[0])) < 0.02
    for other in (noise[1], np.roll(noise[0], 1, axis=0), np.roll(noise[0], 1, axis=1)):
        assert abs(np.corrcoef(noise[0].ravel(), other.ravel())[0, 1]) < 0.01


def test_the_same_frame_is_the_same_picture() -> None:
    scene = anchor_scene(tag_at((0.0, 0.0, 0.0)))
    pose = looking_down(0.1, 0.0, 2.0)
    first, again = (render(scene, at(pose), Sensor(), sequence=5) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def edge_width_px(image: GreyImage) -> float:
    """Return how wide (px) the step from white to black is in the row through the tag's left black border."""
    row = image[360].astype(float)
    left = row[560:640]
    white = int(np.argmax(left))
    black = white + int(np.argmin(left[white:]))
    slope = np.abs(np.diff(left[white - 2 : black + 3])).max()
    return float((left[white] - left[black]) / slope)


def test_motion_blurs_along_the_motion_and_leaves_the_tag_at_mid_exposure() -> None:
    anchor = tag_at((0.0, 0.0, 0.0))
    still, moving = Sensor(0.004, 0.0, 0.7), Sensor(0.02, 0.0, 0.7)

    def fly(stamp_s: float) -> Transform:
        return looking_down(0.8 * stamp_s, 0.0, 2.0)  # 0.8 m/s at 2 m: 6.6 px in 20 ms

    sharp = render(anchor_scene(anchor), at(looking_down(0.0, 0.0, 2.0)), still)
    blurred = render(anchor_scene(anchor), fly, moving)
    assert edge_width_px(sharp) < 3.0
    assert edge_width_px(blurred) == pytest.approx(6.6, abs=1.5)
    corners = found_corners(blurred)
    assert corners is not None
    np.testing.assert_allclose(corners.mean(axis=0), [640.0, 360.0], atol=0.15)


def test_a_robot_hides_the_anchor_that_it_stands_on() -> None:
    robot = Body(
        "robot", (BodyTag(TagKey("tag36h11", 1), SIZE_M, transform(np.eye(3), np.array([0, 0, 0.1]))),), "static"
    )
    scene = anchor_scene(targets={"robot": robot})
    x, y = scene.poses(0.0)["robot"][:2, 3]
    scene = anchor_scene(tag_at((x, y, 0.0)), targets={"robot": robot})
    image = render(scene, at(looking_down(x + 0.2, y, 2.0)))
    assert found_corners(image, 1) is not None
    assert found_corners(image, 7) is None


def test_a_box_hides_what_is_behind_it_and_not_what_is_before_it() -> None:
    box = ((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6))
    behind, before, beside = (
        tag_at((0.6, 0.0, 0.0), key=TagKey("tag36h11", 1)),
        tag_at((-0.6, 0.0, 0.0), key=TagKey("tag36h11", 2)),
        tag_at((0.0, 1.0, 0.0), key=TagKey("tag36h11", 3)),
    )
    lean = np.deg2rad(-50.0)
    T = transform(
        np.column_stack([[0.0, -1.0, 0.0], [np.sin(lean), 0.0, -np.cos(lean)], [np.cos(lean), 0.0, np.sin(lean)]]),
        np.array([-1.8, 0.0, 1.8]),
    )
    image = render(anchor_scene(behind, before, beside, keep_out=(box,)), at(T))
    assert found_corners(image, 1) is None
    assert found_corners(image, 2) is not None
    assert found_corners(image, 3) is not None


def test_unknown_families_and_ids_are_refused() -> None:
    with pytest.raises(InputError, match="cannot draw tagStandard41h12"):
        anchor_scene(tag_at((0.0, 0.0, 0.0), key=TagKey("tagStandard41h12", 0)))
    with pytest.raises(InputError, match="tag25h9 has the ids 0 to 34"):
        tag_cells(TagKey("tag25h9", 35))
