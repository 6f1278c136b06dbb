"""Odd scenes through ``camrig plan``: each is answered or refused with a sentence; no traceback, no NaN out."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from camrig.cli.main import main

LENS = "lenses:\n  lab: {size_px: [1280, 800], fx: 800, fy: 800, cx: 640, cy: 400, distortion: [-0.3, 0.1, 0, 0]}\n"
HEAD = "{id: c1, lens: lab, mount: head, position_m: [1, 2, 2.8], tilt_deg: [-90, -5]}"
DRONE = "{id: d1, lens: lab, mount: drone, box_m: [[0, 0, 1], [5, 3, 3]]}"
FIXED = "{id: f1, lens: lab, mount: fixed, position_m: [1, 2, 2.8], tilt_deg: -90}"
NEAR, FAR = "[1.5, 2, 0]", "[500, -500, 0]"


class Answer(NamedTuple):
    code: int
    line: dict[str, Any]
    said: str


Ask = Callable[..., Answer]


@pytest.fixture(params=["pixel", "fisher", "perspective"])
def ask(
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Ask:
    """Return ``ask(cameras, targets, ...)``: what the program answers, by every quality model."""

    def run(cameras: list[str], places: list[str], visibility: str = "image", rest: str = "") -> Answer:
        path = tmp_path / "room.yaml"
        targets = "".join(f"  - {{id: t{n}, position_m: {at}, tag_size_m: 0.1}}\n" for n, at in enumerate(places))
        listed = "".join(f"  - {camera}\n" for camera in cameras)
        path.write_text(f"{LENS}cameras:\n{listed}targets:\n{targets}{rest}")
        flags = ["--json", "--quality", request.param, "--visibility", visibility, "--deadline-s", "2"]
        monkeypatch.setattr(sys, "argv", ["camrig", "plan", str(path), *flags])
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        assert "nan" not in out.lower()
        return Answer(int(caught.value.code or 0), json.loads(out) if out else {}, err)

    return run


def finite(node: object) -> bool:
    if isinstance(node, dict):
        return all(finite(item) for item in node.values())
    if isinstance(node, list):
        return all(finite(item) for item in node)
    return not isinstance(node, float) or math.isfinite(node)


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize("camera", [HEAD, DRONE, FIXED])
def test_two_targets_at_one_point_are_seen_alike(ask: Ask, camera: str, visibility: str) -> None:
    code, line, _ = ask([camera], [NEAR, NEAR], visibility)
    assert (code, line["uncovered"]) == (0, [])
    assert line["targets"]["t0"] == line["targets"]["t1"]
    assert finite(line)


@pytest.mark.parametrize("visibility", ["cone", "image"])
@pytest.mark.parametrize(
    "camera", [HEAD, FIXED, HEAD.replace("position_m: [1, 2, 2.8]", "surface_m: [[1, 2, 2.8], [2, 2, 2.8]]")]
)
def test_a_target_at_a_cameras_place_is_not_seen_from_there(ask: Ask, camera: str, visibility: str) -> None:
    code, line, _ = ask([camera], ["[1, 2, 2.8]", NEAR], visibility)
    assert (code, line["uncovered"]) == (4, ["t0"])
    assert line["targets"]["t1"]["quality_m"] > 0.0
    assert finite(line)


def test_a_target_in_the_middle_of_a_drones_box_is_answered(ask: Ask) -> None:
    code, line, _ = ask([DRONE], ["[2.5, 1.5, 2]"])
    assert (code, line["uncovered"]) == (0, [])


@pytest.mark.parametrize(
    "camera",
    [
        HEAD.replace("[-90, -5]", "[60, 89]"),
        HEAD.replace("tilt_deg", "pan_deg: [-181, -179], tilt_deg").replace("[-90, -5]", "[-5, 0]"),
        DRONE.replace("[[0, 0, 1], [5, 3, 3]]", "[[90, 90, 1], [91, 91, 1.1]]"),
    ],
)
def test_limits_that_exclude_everything_leave_all_targets_uncovered(ask: Ask, camera: str) -> None:
    code, line, _ = ask([camera], [NEAR])
    assert (code, line["objective_m"], line["uncovered"]) == (4, None, ["t0"])
    assert line["status"] in {"partial", "infeasible"}
    assert finite(line["cameras"])


def test_what_no_camera_reaches_is_named_and_the_rest_is_planned(ask: Ask) -> None:
    code, line, _ = ask([HEAD, DRONE], [FAR, NEAR], rest="planner: {max_range_m: 9}\n")
    assert (code, line["uncovered"]) == (4, ["t0"])
    assert line["targets"]["t1"]["quality_m"] > 0.0
    code, line, _ = ask([HEAD], [NEAR], rest="planner: {max_range_m: 1}\n")
    assert (code, line["uncovered"]) == (4, ["t0"])


def test_drones_that_can_be_nowhere_are_refused(ask: Ask) -> None:
    rest = "space: {floor_m: [[0, 0], [5, 3]], keep_out_m: [[[-1, -1, 0], [6, 4, 4]]]}\n"
    code, line, said = ask([DRONE], [NEAR], rest=rest)
    assert code == 2
    assert "outside the keep-out boxes" in line["error"]
    assert line["error"] in said


def test_who_can_see_no_anchor_is_refused(ask: Ask) -> None:
    camera = HEAD.replace("}", ", needs_anchor: true}")
    code, line, _ = ask([camera], [NEAR], rest="anchors:\n  - {position_m: [1, 2, 9], tag_size_m: 0.2}\n")
    assert code == 2
    assert "c1" in line["error"]
    assert "anchor" in line["error"]


@pytest.mark.parametrize(
    ("cameras", "places", "says"),
    [
        ([HEAD], [], "targets: must be a list with at least one of the targets"),
        ([], [NEAR], "cameras: must be a list with at least one of the cameras"),
        ([HEAD], ["[.nan, 0, 0]"], "targets[t0].position_m[0]"),
        ([HEAD], ["[.inf, 0, 0]"], "targets[t0].position_m[0]"),
        ([HEAD.replace("2.8", "-.inf")], [NEAR], "cameras[c1].position_m[2]"),
        ([HEAD.replace("-90", ".nan")], [NEAR], "cameras[c1].tilt_deg[0]"),
        ([HEAD.replace("[-90, -5]", "[-5, -90]")], [NEAR], "the first limit must be below the second"),
        ([DRONE.replace("[5, 3, 3]", "[5, 3, .nan]")], [NEAR], "cameras[d1].box_m"),
        ([DRONE.replace("[5, 3, 3]", "[0, 0, 1]")], [NEAR], "the box is empty"),
    ],
)
def test_nothing_and_no_numbers_are_refused_with_line_and_key(
    ask: Ask, cameras: list[str], places: list[str], says: str
) -> None:
    code, line, said = ask(cameras, places)
    assert (code, line) == (2, {})
    assert says in said
    assert "room.yaml:" in said
