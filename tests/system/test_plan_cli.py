"""``camrig plan`` as its users meet it: the reference scenes, lines, exit codes, sentences, a picture."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import pytest

from camrig.cli.main import main
from camrig.messages import PlanStatus, RigPlan
from camrig.optimise import Scene, plan

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
    ("visibility", "key", "worst_gap"), [("cone", "cone_paperQ_mean", 0.01), ("image", "rect_paperQ_mean", 0.02)]
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
    assert (answer["status"] in {"partial", "infeasible"}, answer["uncovered"]) == (True, ["t2"])
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
        (["--quality", "magic"], "pixel or fisher or perspective"),
        (["--visibility", "sphere"], "cone or image"),
        (["--objective", "median"], "mean or worst"),
        (["--solver", "magic"], "slsqp"),
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


@pytest.mark.parametrize(("quality", "unit"), [("pixel", "mm/px"), ("fisher", "mm rms"), ("perspective", "mm/px")])
def test_people_get_tables_in_the_unit_of_the_quality(camrig_plan: Plan, scene: Path, quality: str, unit: str) -> None:
    scene.write_text(LENS + HEAD + "targets:\n" + SEEN.replace("}", ", tag_size_m: 0.1}"))
    run = camrig_plan(scene, "--quality", quality, "--objective", "worst")
    assert run.returncode == 0, run.stderr
    assert f"quality, {unit}" in run.stdout
    summary = run.stdout.splitlines()[-1]
    assert summary.startswith("worst ")
    assert f"{unit}, 1 of 1 targets covered" in summary


def test_a_camera_to_be_mounted_comes_with_its_place_and_a_zoom_with_its_position(
    camrig_plan: Plan, scene: Path
) -> None:
    table = "[{position: 0, fx: 900, fy: 900}, {position: 99, fx: 9000, fy: 9000}]"
    zoomed = f"  zoomed: {{size_px: [1280, 720], zoom: {table}}}\n"
    ceiling = "cameras:\n  - {id: c1, lens: zoomed, mount: head, surface_m: [[0, 0, 2.8], [5, 3, 2.8]]}\n"
    scene.write_text(LENS + zoomed + ceiling + "targets:\n" + SEEN)
    run = camrig_plan(scene, "--json")
    assert run.returncode == 0, run.stderr
    camera = lines(run)[0]["cameras"]["c1"]
    x, y, z = camera["position_m"]
    assert (0.0 <= x <= 5.0, 0.0 <= y <= 3.0, z) == (True, True, 2.8)
    assert camera["zoom"] == pytest.approx(99.0)
    assert {"pan_deg", "tilt_deg"} < set(camera)
    assert "zoom 99" in camrig_plan(scene).stdout


def test_a_plan_proven_infeasible_is_shown_and_ends_as_a_partial_one(
    camrig_plan: Plan, scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def infeasible(scene: Scene, **options: Any) -> RigPlan:
        return replace(plan(scene, **options), status=PlanStatus.INFEASIBLE)

    monkeypatch.setattr("camrig.optimise.plan", infeasible)
    scene.write_text(LENS + HEAD + "targets:\n" + SEEN + HIGH)
    run = camrig_plan(scene, "--json")
    assert (run.returncode, lines(run)[0]["status"]) == (4, "infeasible")
    run = camrig_plan(scene)
    assert (run.returncode, "room: infeasible" in run.stdout) == (4, True)


@pytest.mark.usefixtures("picture_fonts")
@pytest.mark.parametrize("ending", ["png", "svg"])
def test_a_plan_is_drawn_to_a_picture(camrig_plan: Plan, scene: Path, tmp_path: Path, ending: str) -> None:
    pictures = [tmp_path / f"{number}.{ending}" for number in range(2)]
    for picture in pictures:
        run = camrig_plan(scene, "--picture", picture)
        assert run.returncode == 0, run.stderr
        assert "1 of 1 targets covered" in run.stdout
    content = pictures[0].read_bytes()
    assert content.startswith(b"\x89PNG" if ending == "png" else b"<?xml")
    assert content == pictures[1].read_bytes(), "the same plan is the same picture"


@pytest.mark.usefixtures("picture_fonts")
def test_a_picture_that_cannot_be_written_is_refused_before_planning(
    camrig_plan: Plan, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusals = {tmp_path / "none" / "plan.png": "no folder", tmp_path / "plan.jpg": ".svg or .png"}
    for picture, words in refusals.items():
        run = camrig_plan(scene, "--picture", picture)
        assert (run.returncode, run.stdout) == (2, "")
        assert str(picture) in run.stderr
        assert words in run.stderr
    assert camrig_plan(scene, scene, "--picture", tmp_path / "plan.svg").returncode == 2
    (tmp_path / "plan.svg").mkdir()
    run = camrig_plan(scene, "--picture", tmp_path / "plan.svg")
    assert (run.returncode, "cannot be written" in run.stderr) == (2, True)
    for module in ("camrig.report.plan_figure", "camrig.report.canvas"):
        monkeypatch.delitem(sys.modules, module)
        monkeypatch.delattr(module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    run = camrig_plan(scene, "--picture", tmp_path / "plan.png")
    assert (run.returncode, run.stdout) == (2, "")
    assert "install camrig[pictures]" in run.stderr


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
