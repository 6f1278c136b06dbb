"""From detections to sightings: exact projections give exact poses, noisy ones the covariance that sampling shows."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from camrig.geometry import pose
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, aim_rotation
from camrig.geometry.pnp import TAG_CORNERS, observe_tags
from camrig.geometry.rotation import rotation_from_rpy, rotation_x, rotation_y, rotation_z
from camrig.locate import Histories, Located, locate
from camrig.locate.fit import angle_between
from camrig.locate.sightings import UPRIGHT_SIGMA_RAD
from camrig.messages import Sighting, TagDetection, TagDetections
from camrig.rig import Body, BodyTag, CameraSpec, FixedMount, FreeMount, Rig, Space, TagKey
from camrig.sensing import pixel_quality

LENS = BrownLens((1280, 720), (827.7, 827.9), (640.0, 360.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
T_WORLD_CAMERA = pose.transform(aim_rotation(0.4, -1.0) @ R_MOUNT_OPTICAL, np.array([0.5, 0.5, 2.6]))
SIZE_M = 0.12


def key(number: int) -> TagKey:
    return TagKey("tag36h11", number)


ROOF = BodyTag(key(1), SIZE_M, pose.transform(np.eye(3), np.array([0.02, 0.0, 0.1])))
ROBOT = Body("robot", (ROOF,), "floor")
WAND = Body("wand", (BodyTag(key(2), SIZE_M, np.eye(4)),), "free")
BOX = Body(
    "box",
    (
        BodyTag(key(3), SIZE_M, pose.transform(np.eye(3), np.array([0.0, 0.0, 0.2]))),
        BodyTag(key(4), SIZE_M, pose.transform(rotation_x(-0.6), np.array([0.0, 0.15, 0.15]))),
        BodyTag(key(5), SIZE_M, pose.transform(rotation_x(0.6), np.array([0.0, -0.15, 0.15]))),
    ),
    "free",
)
RIG = Rig(
    "test",
    Space(),
    {"wall": CameraSpec("wall", LENS, FixedMount(T_WORLD_CAMERA)), "hand": CameraSpec("hand", LENS, FreeMount())},
    targets={body.id: body for body in (ROBOT, WAND, BOX)},
)
STANDING = pose.transform(rotation_z(0.7), np.array([1.6, 1.0, 0.0]))


def opencv_pixels(T_camera_tag: Transform, size_m: float = SIZE_M) -> Array:
    K = np.array([[827.7, 0.0, 640.0], [0.0, 827.9, 360.0], [0.0, 0.0, 1.0]])
    rvec = cv2.Rodrigues(T_camera_tag[:3, :3])[0]
    pixels, _ = cv2.projectPoints(size_m * TAG_CORNERS, rvec, T_camera_tag[:3, 3], K, np.array(LENS.distortion))
    return np.asarray(pixels[:, 0], dtype=float)


def seen(
    *bodies: tuple[Body, Transform],
    rng: np.random.Generator | None = None,
    T_world_camera: Transform = T_WORLD_CAMERA,
    camera_id: str = "wall",
) -> TagDetections:
    """All tags of bodies at ``T_world_body``; with the noise law's own noise where ``rng`` is given."""
    tags = []
    for body, T_world_body in bodies:
        for tag in body.tags:
            corners = opencv_pixels(pose.invert(T_world_camera) @ T_world_body @ tag.T_body_tag)
            if rng is not None:
                corners = corners + rng.normal(size=(4, 2)) * observe_tags(LENS, corners[None]).sigma_px[0, :, None]
            x, y = corners.mean(axis=0)
            tags.append(TagDetection(tag.key, corners, (float(x), float(y)), 0, 60.0))
    return TagDetections(camera_id, 3.0, 7, LENS.size_px, tuple(tags), 0.01)


def look(detections: TagDetections, priors: dict[str, Transform] | None = None) -> Located:
    return locate(detections, Histories(), RIG, priors or {})


def only(found: Located) -> Sighting:
    (sighting,) = found.sightings
    return sighting


def facing_camera(tilt_rad: float, distance_m: float, spin_rad: float = 0.3) -> Transform:
    """A body before the wall camera whose z leans by ``tilt_rad`` from the line of sight."""
    T_camera_body = pose.transform(
        np.diag([1.0, -1.0, -1.0]) @ rotation_x(tilt_rad) @ rotation_z(spin_rad), np.array([0.1, -0.05, distance_m])
    )
    return T_WORLD_CAMERA @ T_camera_body


def within_chance(values: list[float], freedoms: int) -> bool:
    """Whether a mean of NEES lies within the two-sided 99.8 % bounds of chi2."""
    n = len(values)
    low, high = (float(chi2.ppf(p, freedoms * n)) / n for p in (0.001, 0.999))
    return bool(low <= np.mean(values) <= high)


def test_exact_corners_give_the_exact_pose_and_the_papers_quality() -> None:
    sighting = only(look(seen((ROBOT, STANDING))))
    assert sighting.T_world_body == pytest.approx(STANDING, abs=1e-5)
    assert (sighting.target_id, sighting.camera_id, sighting.stamp_s, sighting.tags) == ("robot", "wall", 3.0, 1)
    tag_in_camera = (pose.invert(T_WORLD_CAMERA) @ STANDING @ ROOF.T_body_tag)[:3, 3]
    assert sighting.quality_m == pytest.approx(float(pixel_quality(LENS, tag_in_camera)), rel=1e-4)


def test_a_body_with_several_tags_is_solved_from_all_of_them() -> None:
    T = facing_camera(0.2, 1.8)
    rng = np.random.default_rng(0)
    detections = seen((BOX, T), rng=rng)
    together = only(look(detections))
    single = only(look(replace(detections, tags=detections.tags[:1])))
    assert (together.tags, single.tags) == (3, 1)
    assert np.trace(together.covariance) < 0.3 * np.trace(single.covariance)
    assert together.T_world_body == pytest.approx(T, abs=0.02)


def test_several_bodies_of_different_sizes_in_one_picture() -> None:
    truth = {
        "robot": STANDING,
        "box": pose.transform(rotation_z(-1.0), np.array([1.3, 0.6, 0.1])),
        "wand": facing_camera(0.5, 1.2),
    }
    found = look(seen(*((RIG.targets[name], T) for name, T in truth.items())))
    assert {sighting.target_id for sighting in found.sightings} == set(truth)
    for sighting in found.sightings:
        assert sighting.T_world_body == pytest.approx(truth[sighting.target_id], abs=1e-4)


def nees_of_draws(body: Body, T: Transform, n: int, seed: int) -> list[float]:
    """NEES of position and attitude over corner noise and the camera's own pose error together."""
    rng = np.random.default_rng(seed)
    pose_of_camera = look(seen()).camera_pose
    assert pose_of_camera is not None
    root = np.linalg.cholesky(pose_of_camera.covariance)
    values = []
    for _ in range(n):
        true_camera = pose.perturb(T_WORLD_CAMERA, root @ rng.normal(size=6))
        sighting = only(look(seen((body, T), rng=rng, T_world_camera=true_camera), {body.id: T}))
        error = pose.difference(T, sighting.T_world_body)
        values.append(float(error @ np.linalg.solve(sighting.covariance + sighting.camera_covariance, error)))
    return values


def test_covariance_and_camera_covariance_together_are_what_sampling_shows() -> None:
    assert within_chance(nees_of_draws(WAND, facing_camera(0.6, 1.5), 500, seed=1), 6)


def test_the_covariance_of_a_body_with_three_tags_is_what_sampling_shows() -> None:
    assert within_chance(nees_of_draws(BOX, facing_camera(0.2, 1.8), 500, seed=2), 6)


def test_a_floor_bodys_covariance_counts_on_its_standing_upright() -> None:
    """Leaning as the model allows, position and attitude stay consistent."""
    rng = np.random.default_rng(3)
    values = []
    for _ in range(500):
        lean = rng.normal(size=2) * UPRIGHT_SIGMA_RAD
        T = STANDING @ pose.transform(rotation_from_rpy(lean[0], lean[1], 0.0), np.zeros(3))
        sighting = only(look(seen((ROBOT, T), rng=rng)))
        error = pose.difference(T, sighting.T_world_body)
        values.append(float(error @ np.linalg.solve(sighting.covariance, error)))
    assert within_chance(values, 6)


def test_counting_on_it_pays_where_a_tag_is_seen_head_on() -> None:
    T_world_camera = pose.transform(aim_rotation(0.0, -np.pi / 2) @ R_MOUNT_OPTICAL, np.array([1.4, 1.1, 3.0]))
    cameras = {"wall": CameraSpec("wall", LENS, FixedMount(T_world_camera))}
    floor = replace(RIG, cameras=cameras)
    free = replace(floor, targets={"robot": replace(ROBOT, motion="free")})
    detections = seen((ROBOT, STANDING), T_world_camera=T_world_camera)
    knowing, not_knowing = (only(locate(detections, Histories(), rig, {"robot": STANDING})) for rig in (floor, free))
    assert np.trace(knowing.covariance[:2, :2]) < 0.5 * np.trace(not_knowing.covariance[:2, :2])


def test_standing_upright_decides_between_two_poses_of_a_floor_body() -> None:
    """Straight below a high camera a tag's two poses look alike; over many draws none may flip."""
    high = pose.transform(aim_rotation(0.0, -np.pi / 2) @ R_MOUNT_OPTICAL, np.array([1.4, 1.1, 5.0]))
    rig = replace(RIG, cameras={"wall": CameraSpec("wall", LENS, FixedMount(high))})
    rng = np.random.default_rng(4)
    for _ in range(100):
        sighting = only(locate(seen((ROBOT, STANDING), rng=rng, T_world_camera=high), Histories(), rig, {}))
        assert angle_between(sighting.T_world_body, STANDING) < 0.1


def test_the_last_known_orientation_decides_where_the_picture_does_not() -> None:
    T = facing_camera(0.15, 4.0)
    rng = np.random.default_rng(5)
    flips = {"with": 0, "without": 0}
    for _ in range(60):
        detections = seen((WAND, T), rng=rng)
        flips["with"] += angle_between(only(look(detections, {"wand": T})).T_world_body, T) > 0.25
        flips["without"] += angle_between(only(look(detections)).T_world_body, T) > 0.25
    assert flips["without"] > 5
    assert flips["with"] < flips["without"] / 2


def test_without_a_prior_the_covariance_covers_both_poses() -> None:
    T = facing_camera(0.25, 4.0)
    rng = np.random.default_rng(6)
    errors = []
    for _ in range(60):
        sighting = only(look(seen((WAND, T), rng=rng)))
        turn = pose.difference(T, sighting.T_world_body)[3:]
        errors.append(float(turn @ np.linalg.solve(sighting.covariance[3:, 3:], turn)))
    assert np.quantile(errors, 0.95) < chi2.ppf(0.9999, 3)


def test_a_clear_picture_is_believed_over_a_wrong_prior() -> None:
    T, other = facing_camera(0.7, 1.0), facing_camera(-0.7, 1.0)
    assert angle_between(only(look(seen((WAND, T)), {"wand": other})).T_world_body, T) < 0.01


def test_tags_that_the_rig_does_not_list_are_reported_and_never_used() -> None:
    detections = seen((ROBOT, STANDING))
    stranger = replace(detections.tags[0], key=key(77))
    found = look(replace(detections, tags=(*detections.tags, stranger)))
    assert found.unlisted == (stranger,)
    assert only(found).tags == 1


def twice() -> TagDetections:
    elsewhere = pose.transform(np.eye(3), np.array([1.2, 0.4, 0.0]))
    return seen((ROBOT, elsewhere), (ROBOT, STANDING))


def test_of_a_tag_seen_twice_the_one_where_it_is_expected_counts() -> None:
    found = look(twice(), {"robot": STANDING})
    assert only(found).T_world_body == pytest.approx(STANDING, abs=1e-5)
    (note,) = found.notes
    assert (note.about, "more than one" in note.text) == ("tag36h11:1", True)


@pytest.mark.parametrize("priors", [{}, {"robot": pose.transform(np.eye(3), np.array([2.2, 1.2, 0.0]))}])
def test_of_a_tag_seen_twice_neither_counts_where_nothing_tells_which_is_meant(priors: dict[str, Transform]) -> None:
    found = look(twice(), priors)
    assert found.sightings == ()
    assert [note.about for note in found.notes] == ["tag36h11:1"]


@pytest.mark.parametrize("R", [rotation_x(0.9), rotation_x(-0.9), rotation_y(0.9), rotation_y(0.5)])
def test_a_floor_body_on_its_side_is_not_placed_but_named(R: Array) -> None:
    fallen = pose.transform(R, np.array([1.6, 1.0, 0.1]))
    found = look(seen((ROBOT, fallen)))
    assert found.sightings == ()
    (note,) = found.notes
    assert note.about == "robot"
    assert "upright" in note.text


def test_a_camera_that_is_nowhere_sees_nothing_in_the_world() -> None:
    found = look(seen((ROBOT, STANDING), camera_id="hand"))
    assert (found.camera_pose, found.sightings) == (None, ())


def test_pictures_of_another_size_than_the_lens_are_not_used() -> None:
    found = look(replace(seen((ROBOT, STANDING)), size_px=(640, 360)))
    assert (found.camera_pose, found.sightings) == (None, ())
    (note,) = found.notes
    assert note.text == "pictures are 640x360, its lens is for 1280x720: not used"


def test_a_tag_past_the_calibrated_radius_does_not_count() -> None:
    narrow = replace(LENS, r_max=0.2)
    rig = replace(RIG, cameras={"wall": CameraSpec("wall", narrow, FixedMount(T_WORLD_CAMERA))})
    at_edge = pose.transform(np.eye(3), np.array([3.1, 1.5, 0.0]))
    assert locate(seen((ROBOT, at_edge)), Histories(), rig, {}).sightings == ()


def test_a_speck_or_a_line_of_corners_is_no_tag() -> None:
    detections = seen((ROBOT, STANDING))
    tag = detections.tags[0]
    for corners in (tag.corners_px[:1] + 0.3 * TAG_CORNERS[:, :2], np.linspace([600.0, 300.0], [640.0, 300.0], 4)):
        broken = replace(tag, corners_px=corners)
        assert look(replace(detections, tags=(broken,))).sightings == ()


@pytest.mark.parametrize("seed", range(4))
def test_garbage_for_corners_never_breaks_it(seed: int) -> None:
    """Any four points: thrown in anywhere, shaken, reordered, squeezed. No error, no warning, nothing not finite."""
    rng = np.random.default_rng(seed)
    whole = seen((ROBOT, STANDING), (BOX, facing_camera(0.2, 1.8)), (WAND, facing_camera(0.5, 1.2)))
    for _ in range(100):
        tags = []
        for tag in whole.tags:
            centre = tag.corners_px.mean(axis=0)
            corners = (
                rng.uniform([0.0, 0.0], LENS.size_px, (4, 2)),
                tag.corners_px + rng.normal(size=(4, 2)) * rng.choice([1.0, 5.0, 30.0]),
                np.roll(tag.corners_px, rng.integers(4), axis=0)[:: rng.choice([1, -1])],
                centre + (tag.corners_px - centre) * rng.uniform(0.01, 6.0, 2),
            )[rng.integers(4)]
            tags.append(replace(tag, corners_px=corners))
        for sighting in look(replace(whole, tags=tuple(tags))).sightings:
            assert np.isfinite(sighting.T_world_body).all()
            assert np.isfinite(sighting.covariance).all()
            assert np.linalg.eigvalsh(sighting.covariance[:3, :3])[0] >= 0.0
