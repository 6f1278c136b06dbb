"""A whole rig from pictures: what stands, what is carried, heads at several aims, lengths, what was moved meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from camrig.calibrate.extrinsics import Extrinsics, Uncertain, extrinsics
from camrig.calibrate.instants import instants_of
from camrig.calibrate.judge import loose_marks, missing_links
from camrig.calibrate.scale import Length, with_lengths
from camrig.calibrate.setup import OnHead, Setup
from camrig.calibrate.sighted import ROOM, SeenBoard, Shot
from camrig.calibrate.stillness import stillness, without_moved
from camrig.errors import InputError
from camrig.geometry.arrays import Array, Transform
from camrig.geometry.lens import BrownLens
from camrig.geometry.pan_tilt import R_MOUNT_OPTICAL, PanTilt, aim_rotation
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, difference, invert, perturb, transform
from camrig.geometry.rotation import rotation_exp

LENS = BrownLens((1280, 800), (827.7, 827.9), (640.0, 400.0), (-0.336, 0.101, 0.0, 0.0, 0.0))
SIZE_M = 0.15
NOISE_PX = 0.2
ANGLE_SIGMA_RAD = np.radians(0.15)
ROOM_TAGS = {f"r{k}": transform(np.eye(3), np.array([0.6 * (k % 4), 0.7 * (k // 4), 0.0])) for k in range(8)}
BOARD_TAGS = {f"b{k}": transform(np.eye(3), np.array([0.2 * (k % 2), 0.2 * (k // 2), 0.0])) for k in range(4)}
SIZES_M = dict.fromkeys((*ROOM_TAGS, *BOARD_TAGS), SIZE_M)


def looking(position_m: list[float], pan_rad: float, tilt_rad: float) -> Transform:
    return transform(aim_rotation(pan_rad, tilt_rad) @ R_MOUNT_OPTICAL, np.array(position_m))


FIXED = {"west": looking([-0.8, 0.3, 2.2], 0.0, -0.95), "east": looking([2.6, 0.4, 2.2], np.pi, -0.95)}
MOUNT = transform(rotation_exp(np.array([0.02, -0.03, 0.01])) @ R_MOUNT_OPTICAL, np.array([0.03, 0.01, 0.05]))
HEAD = PanTilt(
    transform(rotation_exp(np.array([0.01, 0.02, 0.4])), np.array([0.9, -0.6, 2.3])),
    transform(np.eye(3), np.array([0.0, 0.02, 0.04])),
)
AIMS = [(pan, tilt) for pan in (0.6, 1.2, 1.8) for tilt in (-1.2, -0.8)]


def seen_by(T_world_camera: Transform, marks: dict[str, Transform], rng: np.random.Generator) -> dict[str, Array]:
    found = {}
    for name, T in marks.items():
        in_camera = apply(invert(T_world_camera) @ T, SIZE_M * TAG_CORNERS)
        pixels = LENS.project(in_camera)
        inside = np.isfinite(pixels) & (pixels > 0) & (pixels < np.array(LENS.size_px))
        if (in_camera[:, 2] > 0.1).all() and inside.all():
            found[name] = pixels + rng.normal(size=(4, 2)) * NOISE_PX
    return found


def carried(rng: np.random.Generator) -> dict[str, Transform]:
    """Where the board's tags are at one instant."""
    about = transform(np.eye(3), np.array([0.9, 0.3, 0.5]))
    T_board = perturb(about, rng.normal(size=6) * [0.3, 0.2, 0.1, 0.2, 0.2, 1.0])
    return {name: T_board @ T for name, T in BOARD_TAGS.items()}


def rig(seed: int, instants: int = 12) -> list[Shot]:
    """A board carried past two fixed cameras, tags on the floor, a camera on a head that stood at six aims.

    What stands looks the same in every picture of a camera, its noise too: that is of prints and lenses, not of pixels.
    """
    rng = np.random.default_rng(seed)
    room = {name: seen_by(T, ROOM_TAGS, rng) for name, T in FIXED.items()}
    shots = []
    for k in range(instants):
        board = carried(rng)
        shots += [Shot(name, k, {**room[name], **seen_by(T, board, rng)}) for name, T in FIXED.items()]
    for k, (pan, tilt) in enumerate(AIMS):
        off = rng.normal(size=2) * ANGLE_SIGMA_RAD
        T = HEAD.T_world_camera(pan + off[0], tilt + off[1], MOUNT)
        shots.append(Shot("head", 100 + k, seen_by(T, ROOM_TAGS, rng), aim_rad=(pan, tilt)))
    return shots


def setup(names: tuple[str, ...] = ("west", "east", "head"), *, find_mount: bool = False, anchors: int = 2) -> Setup:
    mount = perturb(MOUNT, np.array([0.01, 0.0, -0.01, 0.02, 0.01, -0.02])) if find_mount else MOUNT
    head = OnHead(HEAD.T_arm_tilt, mount, ANGLE_SIGMA_RAD, find_mount)
    known = dict(list(ROOM_TAGS.items())[:anchors])
    return Setup(
        lenses=dict.fromkeys(names, LENS),
        sizes_m=SIZES_M,
        anchors=known,
        bodies=dict.fromkeys(ROOM_TAGS.keys() - known.keys(), ROOM),
        heads={"head": head} if "head" in names else {},
    )


def nees(true: Transform, found: Uncertain) -> float:
    error = difference(true, found.T)
    return float(error @ np.linalg.solve(found.covariance, error))


def test_fixed_cameras_heads_and_free_tags_are_placed_together_as_well_as_is_said() -> None:
    """NEES of both kinds of camera and of one free tag over rigs, within the 99.8 % bounds of its mean."""
    errors: dict[str, list[float]] = {"west": [], "head": [], "r5": []}
    for seed in range(8):
        found = extrinsics(rig(seed), setup())
        assert found.unplaced == ()
        errors["west"].append(nees(FIXED["west"], found.cameras["west"]))
        errors["head"].append(nees(HEAD.T_world_base, found.bases["head"]))
        errors["r5"].append(nees(ROOM_TAGS["r5"], found.room["r5"]))
        assert np.abs(found.aims_off_deg["head"]).max() < 1.0
    low, high = (float(chi2.ppf(p, 48)) / 8 for p in (0.001, 0.999))
    for name, of in errors.items():
        assert low <= np.mean(of) <= high, name


def test_how_a_camera_sits_on_its_head_is_found_too() -> None:
    found = extrinsics(rig(3), setup(find_mount=True))
    error = difference(MOUNT, found.mounts["head"].T)
    assert np.linalg.norm(error[:3]) < 0.01
    assert np.linalg.norm(error[3:]) < 0.005
    assert nees(MOUNT, found.mounts["head"]) < float(chi2.ppf(0.999, 6))


def test_aims_off_are_those_that_the_head_kept_to_itself() -> None:
    """Three head stops off by a known angle each, against six that are not: the difference shows."""
    rng = np.random.default_rng(5)
    off = np.radians(np.where(np.arange(len(AIMS))[:, None] % 2 == 0, [0.2, -0.2], [-0.2, 0.2]))
    shots = [
        Shot(
            "head",
            k,
            seen_by(HEAD.T_world_camera(aim[0] + off[k, 0], aim[1] + off[k, 1], MOUNT), ROOM_TAGS, rng),
            aim_rad=aim,
        )
        for k, aim in enumerate(AIMS)
    ]
    found = extrinsics(shots, setup(("head",), anchors=8))
    assert found.aims_off_deg["head"] == pytest.approx(np.degrees(off), abs=0.03)
    blind = Shot("head", 99, {}, aim_rad=(-1.0, 0.0))
    again = extrinsics([blind, *shots], setup(("head",), anchors=8))
    assert again.aims_off_deg["head"] == pytest.approx(found.aims_off_deg["head"])


def test_what_stands_and_what_is_carried_is_told_by_the_pictures() -> None:
    told = stillness(rig(1), frozenset({"r0"}))
    assert told.carried == set(BOARD_TAGS)
    assert told.still == set(ROOM_TAGS)
    assert told.moved == ()
    assert told.walking == ()


def test_a_tag_that_was_moved_half_way_is_named_with_its_instant_and_used_before() -> None:
    shots = [
        replace(shot, corners_px={**shot.corners_px, "r5": shot.corners_px["r5"] + 40.0})
        if 7 <= shot.instant < 100 and "r5" in shot.corners_px
        else shot
        for shot in rig(1)
    ]
    told = stillness(shots, frozenset({"r0"}))
    assert [(each.mark, each.instant) for each in told.moved] == [("r5", 7)]
    assert told.moved[0].by_px == pytest.approx(40.0 * np.sqrt(2.0), abs=2.0)
    assert "r5" in told.still
    kept = without_moved(shots, told.moved)
    assert not any("r5" in shot.corners_px for shot in kept if shot.instant >= 7)
    assert "r5" in extrinsics(kept, setup()).room


def test_a_camera_that_was_bumped_is_named_instead_of_all_it_sees() -> None:
    shots = [
        replace(shot, corners_px={name: px + 30.0 for name, px in shot.corners_px.items()})
        if shot.camera_id == "west" and shot.instant >= 6
        else shot
        for shot in rig(2)
    ]
    shots = [replace(s, corners_px={n: p for n, p in s.corners_px.items() if n in ROOM_TAGS}) for s in shots]
    told = stillness(shots, frozenset())
    assert [(each.camera, each.mark, each.instant) for each in told.moved] == [("west", "", 6)]
    assert all(shot.instant < 6 for shot in without_moved(shots, told.moved) if shot.camera_id == "west")


def test_a_camera_that_walks_is_told_by_its_anchors() -> None:
    rng = np.random.default_rng(0)
    walk = [perturb(FIXED["west"], np.array([0.05 * k, 0.02 * k, 0, 0, 0, 0])) for k in range(8)]
    shots = [Shot("west", k, seen_by(T, ROOM_TAGS, rng)) for k, T in enumerate(walk)]
    assert stillness(shots, frozenset({"r1"})).walking == ("west",)


def test_a_tag_that_comes_off_its_board_is_named_with_the_instant() -> None:
    rng = np.random.default_rng(4)
    shots = []
    for k in range(14):
        marks = carried(rng)
        if k >= 9:
            marks["b2"] = marks["b2"] @ transform(np.eye(3), np.array([0.03, 0.0, 0.0]))
        shots += [Shot(name, k, seen_by(T, marks, rng)) for name, T in FIXED.items()]
    found = extrinsics(shots, setup(("west", "east")))
    assert [(loose.mark, loose.instant, loose.since) for loose in loose_marks(found)] == [("b2", 9, True)]


def test_one_measured_length_says_how_large_all_tags_are() -> None:
    """Tags that stand in the room, of a size nobody knows: a tape between two of them puts everything right."""
    wrong = replace(setup(("west", "east"), anchors=0), sizes_m=dict.fromkeys(SIZES_M, 0.1))
    length = Length("r0", "r3", 1.8)
    scaled = with_lengths(rig(1), wrong, [length], boards=False)
    assert scaled.factor == pytest.approx(SIZE_M / 0.1, rel=2e-3)
    apart = [
        np.linalg.norm(T["west"][:3, 3] - T["east"][:3, 3])
        for T in ({name: pose.T for name, pose in scaled.found.cameras.items()}, FIXED)
    ]
    assert apart[0] == pytest.approx(apart[1], rel=3e-3)
    assert scaled.misfits[0].found_m == pytest.approx(1.8, rel=1e-4)


def test_a_wand_says_how_large_all_tags_are() -> None:
    """A bar with a tag at either end, carried past two cameras; only how far apart these are is known."""
    shots = [replace(s, corners_px={n: px for n, px in s.corners_px.items() if n in ("b0", "b3")}) for s in rig(6, 20)]
    wrong = replace(setup(("west", "east"), anchors=0), sizes_m=dict.fromkeys(SIZES_M, 0.1))
    length = Length("b0", "b3", 0.2 * np.sqrt(2.0))
    scaled = with_lengths([s for s in shots if s.camera_id != "head"], wrong, [length], boards=False)
    assert scaled.factor == pytest.approx(SIZE_M / 0.1, rel=5e-3)
    apart = [
        np.linalg.norm(T["west"][:3, 3] - T["east"][:3, 3])
        for T in ({name: pose.T for name, pose in scaled.found.cameras.items()}, FIXED)
    ]
    assert apart[0] == pytest.approx(apart[1], rel=5e-3)


def test_between_anchors_a_length_is_only_compared() -> None:
    scaled = with_lengths(rig(1), setup(), [Length("r0", "r3", 1.9)], boards=False)
    assert scaled.factor is None
    assert scaled.misfits[0].found_m == pytest.approx(1.8, abs=0.005)


@pytest.mark.parametrize(
    ("length", "says"),
    [(Length("r0", "r99", 1.0), "r99 is not placed"), (Length("r0", "b1", 1.0), "one stands in the room")],
)
def test_a_length_that_cannot_be_compared_is_told(length: Length, says: str) -> None:
    with pytest.raises(InputError, match=says):
        with_lengths(rig(1), setup(), [length], boards=False)


def test_boards_of_which_pictures_show_different_parts_place_cameras() -> None:
    rng = np.random.default_rng(7)
    points = np.array([[0.05 * x, 0.05 * y, 0.0] for y in range(5) for x in range(6)])
    shots = []
    for k in range(10):
        T_board = carried(rng)["b0"]
        for name, T in FIXED.items():
            some = np.sort(rng.choice(len(points), size=17, replace=False))
            pixels = LENS.project(apply(invert(T) @ T_board, points[some])) + rng.normal(size=(17, 2)) * NOISE_PX
            shots.append(Shot(name, k, {}, {"board": SeenBoard(points[some], pixels)}))
    found = extrinsics(shots, Setup(dict.fromkeys(FIXED, LENS), {}, kept={"west": FIXED["west"]}))
    assert found.noise_px == pytest.approx(NOISE_PX, rel=0.1)
    assert sum(map(len, found.residual_px)) == 10 * 2 * 17
    assert nees(FIXED["east"], found.cameras["east"]) < float(chi2.ppf(0.999, 6))
    assert found.shared == {("west", "east"): 10}


def test_tags_that_one_camera_alone_sees_are_tied_by_what_is_carried() -> None:
    """Two cameras that share no tag of the room: a board joins them, and the tags of the second with them."""
    shots = []
    for shot in rig(1):
        own = {"west": ("r0", "r1", "b"), "east": ("r2", "r3", "b")}.get(shot.camera_id, ())
        shots.append(replace(shot, corners_px={n: px for n, px in shot.corners_px.items() if n.startswith(own)}))
    found = extrinsics([shot for shot in shots if shot.camera_id != "head"], setup(("west", "east")))
    assert found.unplaced == ()
    assert nees(ROOM_TAGS["r3"], found.room["r3"]) < float(chi2.ppf(0.999, 6))


def test_the_missing_link_is_between_those_that_stand_nearest() -> None:
    places = {name: np.array([x, 0.0, 0.0]) for name, x in (("a", 0.0), ("b", 1.0), ("c", 2.2), ("d", 5.0))}
    shared = {("a", "b"): 9, ("c", "d"): 0, ("b", "c"): 0}
    assert missing_links(tuple(places), shared, places) == [("c", "b"), ("d", "b")]


def test_pictures_are_of_one_instant_by_their_stamps() -> None:
    stamps = {"a": np.array([0.0, 0.1, 0.2, 0.3]), "b": np.array([0.012, 0.108, 0.291])}
    assert {name: of.tolist() for name, of in instants_of(stamps).items()} == {"a": [0, 1, 2, 3], "b": [0, 1, 3]}
    with pytest.raises(InputError, match="the stamps of b do not ascend"):
        instants_of({"a": stamps["a"], "b": np.array([0.1, 0.1])})


def test_nothing_is_placed_from_what_nobody_tied() -> None:
    found: Extrinsics = extrinsics([s for s in rig(1) if s.camera_id != "head"], setup(("west", "east", "head")))
    assert found.unplaced == ("head",)
