"""``camrig plan`` as its users meet it: the reference scenes, lines, exit codes, sentences, a picture."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from camrig.cli.main import main

LENS = (
    "lenses:\n  lab: {size_px: [1280, 800], fx: 827.7, fy: 827.9, cx: 640, cy: 400, distortion: [-0.33, 0.1, 0, 0]}\n"
)
HEAD = "cameras:\n  - {id: c1, lens: lab, mount: head, position_m: [1, 2, 2.8], tilt_deg: [-90, -5]}\n"
SEEN, HIGH = "  - {id: t1, position_m: [1.5, 2, 0]}\n", "  - {id: t2, position_m: [1, 2, 9]}\n"


class Run(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


Plan = Callable[..., Run]


@pytest.fixture
def camrig_plan(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Plan:
    """The whole program in this process: a new one takes a second to start."""

    def run(*arguments: object) -> Run:
        monkeypatch.setattr(sys, "argv", ["camrig", "plan", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        return Run(int(caught.value.code or 0), *capsys.readouterr())

    return run


def lines(run: Run) -> list[dict[str, Any]]:
    return [json.loads(line) for line in run.stdout.splitlines()]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(LENS + HEAD + "targets:\n" + SEEN)
    return path


@pytest.mark.parametrize(
    ("visibility", "key", "worst_gap"), [("cone", "cone_paperQ_mean", 1e-6), ("image", "rect_paperQ_mean", 0.002)]
)
def test_the_reference_scenes_are_planned_as_well_as_is_known(
    camrig_plan: Plan, shared_data: Path, visibility: str, key: str, worst_gap: float
) -> None:
    folder = shared_data / "scenes"
    known = json.loads((folder / "best_known.json").read_text())["scenes"]
    run = camrig_plan(*sorted(folder.glob("*.yaml")), "--json", "--visibility", visibility)
    assert run.returncode == 0, run.stderr
    answers = {answer["scene"]: answer for answer in lines(run)}
    assert set(answers) == set(known)
    assert all(len(answer["uncovered"]) <= known[name][key]["uncovered"] for name, answer in answers.items())
    gaps = [answer["objective_m"] / known[name][key]["mean_Qbar_m"] - 1.0 for name, answer in answers.items()]
    assert median(gaps) <= 1e-6
    assert max(gaps) <= worst_gap


def test_a_line_says_where_every_camera_looks_and_who_sees_what(camrig_plan: Plan, scene: Path) -> None:
    text = scene.read_text() + "planner: {visibility: image}\n"
    drone = "  - {id: d1, lens: lab, mount: drone, box_m: [[0, 0, 1], [5, 3, 3]]}\n"
    fixed = "  - {id: f1, lens: lab, mount: fixed, position_m: [3, 2, 2.5], pan_deg: 30, tilt_deg: -60}\n"
    scene.write_text(text.replace("targets:", drone + fixed + "targets:"))
    run = camrig_plan(scene, "--json")
    assert run.returncode == 0, run.stderr
    (answer,) = lines(run)
    assert (answer["scene"], answer["file"], answer["status"]) == ("room", str(scene), "optimised")
    assert set(answer["cameras"]["c1"]) == {"pan_deg", "tilt_deg"}
    assert set(answer["cameras"]["d1"]) == {"position_m", "yaw_deg"}
    assert answer["cameras"]["f1"] == pytest.approx({"pan_deg": 30.0, "tilt_deg": -60.0})
    assert set(answer["targets"]["t1"]["seen_by"]) >= {"c1", "d1"}
    assert answer["objective_m"] == pytest.approx(answer["targets"]["t1"]["quality_m"])
    assert 0.0 < answer["solve_s"] < 5.0


def test_the_same_seed_gives_the_same_plan(camrig_plan: Plan, scene: Path) -> None:
    first, second = (lines(camrig_plan(scene, "--json", "--seed", 5))[0] for _ in range(2))
    assert (first.pop("solve_s") > 0.0, second.pop("solve_s") > 0.0) == (True, True)
    assert first == second


def test_what_nothing_can_see_is_named_and_the_exit_code_is_4(camrig_plan: Plan, scene: Path) -> None:
    scene.write_text(LENS + HEAD + "targets:\n" + SEEN + HIGH)
    run = camrig_plan(scene, "--json")
    assert run.returncode == 4
    (answer,) = lines(run)
    assert (answer["status"], answer["uncovered"]) == ("partial", ["t2"])
    assert answer["targets"]["t2"] == {"quality_m": None, "seen_by": []}
    scene.write_text(LENS + HEAD + "targets:\n" + HIGH)
    assert lines(camrig_plan(scene, "--json"))[0]["objective_m"] is None


def test_bad_scenes_are_refused_together_before_anything_is_planned(
    camrig_plan: Plan, scene: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(LENS + HEAD.replace("head", "hed") + "targets:\n" + SEEN.replace("position_m", "position"))
    run = camrig_plan(scene, bad, tmp_path / "nowhere.yaml", "--json")
    assert (run.returncode, run.stdout) == (2, "")
    for words in ("bad.yaml:4", "cameras[c1].mount", "bad.yaml:6", "targets[t1].position", "nowhere.yaml"):
        assert words in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--quality", "fisher"], "pixel"),
        (["--visibility", "sphere"], "cone or image"),
        (["--objective", "median"], "mean"),
        (["--solver", "magic"], "descent"),
        (["--deadline-s", "0"], "above 0"),
    ],
)
def test_a_flag_that_is_not_built_is_refused_with_what_is(
    camrig_plan: Plan, scene: Path, flags: list[str], words: str
) -> None:
    run = camrig_plan(scene, *flags)
    assert (run.returncode, run.stdout) == (2, "")
    assert flags[0] in run.stderr
    assert words in run.stderr


def test_a_scene_that_has_no_plan_does_not_stop_the_others(camrig_plan: Plan, scene: Path, tmp_path: Path) -> None:
    crowded = tmp_path / "crowded.yaml"
    drones = [
        f"  - {{id: d{i}, lens: lab, mount: drone, box_m: [[0, 0, 1], [1, 1, 2]], min_separation_m: 9}}\n"
        for i in range(2)
    ]
    crowded.write_text(LENS + "cameras:\n" + "".join(drones) + "targets:\n" + SEEN)
    run = camrig_plan(crowded, scene, "--json")
    assert run.returncode == 4
    failed, planned = lines(run)
    assert "min_separation_m" in failed["error"]
    assert planned["status"] == "optimised"
    assert camrig_plan(crowded).returncode == 2


def test_people_get_tables_and_a_map(camrig_plan: Plan, scene: Path, tmp_path: Path) -> None:
    picture = tmp_path / "plan.png"
    run = camrig_plan(scene, "--picture", picture)
    assert run.returncode == 0, run.stderr
    assert "c1" in run.stdout
    assert "1 of 1 targets covered" in run.stdout
    image = cv2.imread(str(picture))
    assert image is not None
    assert min(image.shape[:2]) > 100
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 5


def test_a_picture_that_cannot_be_written_is_named(camrig_plan: Plan, scene: Path, tmp_path: Path) -> None:
    run = camrig_plan(scene, "--picture", tmp_path / "none" / "plan.png")
    assert run.returncode == 2
    assert "plan.png" in run.stderr
    assert camrig_plan(scene, "--picture", tmp_path / "plan.xyz").returncode == 2


def test_the_plan_really_looks_at_its_target(camrig_plan: Plan, scene: Path) -> None:
    (answer,) = lines(camrig_plan(scene, "--json"))
    pan, tilt = (math.radians(answer["cameras"]["c1"][key]) for key in ("pan_deg", "tilt_deg"))
    axis = np.array([math.cos(tilt) * math.cos(pan), math.cos(tilt) * math.sin(pan), math.sin(tilt)])
    ray = np.array([0.5, 0.0, -2.8])
    off_axis = math.degrees(math.acos(float(axis @ ray) / float(np.linalg.norm(ray))))
    assert off_axis < 1.0


def test_the_installed_program_is_the_same(scene: Path) -> None:
    command = [sys.executable, "-m", "camrig", "plan", str(scene), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(run.stdout)["status"] == "optimised"
