"""``camrig experiment`` as its users meet it: a tiny table, its JSON, sentences and exit codes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from camrig.cli.main import main

TINY = ("--sizes", "2x2", "--runs", "2", "--solvers", "camrig,greedy,hold")


class Run(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


Experiment = Callable[..., Run]


@pytest.fixture
def experiment(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Experiment:
    """The whole program in this process: a new one takes a second to start."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def run(*arguments: object) -> Run:
        monkeypatch.setattr(sys, "argv", ["camrig", "experiment", "planner", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        return Run(int(caught.value.code or 0), *capsys.readouterr())

    return run


def answer(run: Run) -> dict[str, Any]:
    assert run.returncode == 0, run.stderr
    (line,) = run.stdout.splitlines()
    found: dict[str, Any] = json.loads(line)
    return found


def test_the_json_holds_every_cell_and_every_scene(experiment: Experiment) -> None:
    found = answer(experiment(*TINY, "--json"))
    assert found["setup"]["sizes"] == [[2, 2]]
    assert found["machine"]["omp_num_threads"] == "1"
    assert found["versions"]["camrig"]
    cells = {(cell["mode"], cell["solver"]): cell for cell in found["cells"]}
    assert set(cells) == {(mode, solver) for mode in ("ptz", "drone") for solver in ("camrig", "greedy", "hold")}
    own = cells["drone", "camrig"]
    assert (own["n"], own["ratio"]["value"], own["uncovered"]) == (2, 1.0, 0)
    assert own["solve_ms"]["median"]["low"] <= own["solve_ms"]["median"]["value"] <= own["solve_ms"]["worst"]
    assert own["cpu_ms"]["median"]["value"] > 0.0
    assert own["gap_percent"] == {"n": 2, "median": {"value": 0, "low": 0, "high": 0}, "p90": 0, "worst": 0}
    assert (own["best"], cells["drone", "hold"]["best"]) == (2, 0)
    assert [cell["n"] for cell in found["together"]] == [4, 4, 4]
    assert [(each["mode"], each["seed"]) for each in found["scenes"]] == [
        ("ptz", 0),
        ("ptz", 1),
        ("drone", 0),
        ("drone", 1),
    ]
    scene = found["scenes"][2]
    assert scene["best"]["objective_m"] <= scene["solvers"]["camrig"]["objective_m"] < 0.01
    assert scene["solvers"]["hold"]["gap"] > 0.0


def test_what_is_found_does_not_change_from_run_to_run(experiment: Experiment) -> None:
    once, again = (answer(experiment(*TINY, "--seed", "5", "--json"))["scenes"] for _ in range(2))
    for first, second in zip(once, again, strict=True):
        assert first["best"] == second["best"]
        for solver, found in first["solvers"].items():
            assert found["objective_m"] == second["solvers"][solver]["objective_m"]


def test_people_get_a_table_with_the_command_that_makes_it(experiment: Experiment, tmp_path: Path) -> None:
    run = experiment(*TINY, "--objective", "worst", "--visibility", "image")
    assert run.returncode == 0, run.stderr
    assert "objective `worst`" in run.stdout
    assert "2 random scenes of every mode and size (seeds 0 to 1)" in run.stdout
    command = next(line for line in run.stdout.splitlines() if line.startswith("OMP_NUM_THREADS=1 camrig"))
    assert "--visibility image --objective worst --quality pixel --solvers camrig,greedy,hold" in command
    table = [line for line in run.stdout.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in table}) == 1
    assert [line.split("|")[1].strip() for line in table[2::3]] == ["ptz 2x2", "drone 2x2", "all"]
    out = tmp_path / "table.md"
    written = experiment(*TINY, "--modes", "ptz", "--out", out)
    assert (written.returncode, written.stdout) == (0, "")
    assert "| ptz 2x2 | camrig | 2 |" in out.read_text()


@pytest.mark.usefixtures("picture_fonts")
def test_a_few_plans_are_drawn(experiment: Experiment, tmp_path: Path) -> None:
    picture = tmp_path / "plans.svg"
    assert experiment("--sizes", "2x2", "--runs", "1", "--solvers", "camrig", "--picture", picture).returncode == 0
    assert "drone 2x2, seed 0" in picture.read_text()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--sizes", "3"], "as in 3x3,5x10, not '3'"),
        (["--sizes", "0x3"], "as in 3x3,5x10, not '0x3'"),
        (["--modes", "boat"], "--modes takes ptz or drone, not 'boat'"),
        (["--solvers", "camrig,magic"], "not 'magic'"),
        (["--visibility", "sphere"], "cone or image"),
        (["--objective", "median"], "mean or worst"),
        (["--quality", "magic"], "pixel or fisher or perspective"),
        (["--out", "/nowhere/table.md"], "in a folder that is there"),
        (["--picture", "/nowhere/plans.svg"], "no folder"),
        (["--picture", "plans.svg", "--solvers", "hold"], "draws the plans of camrig"),
        (["--runs", "0"], "--runs"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is_run(
    experiment: Experiment, flags: list[str], words: str
) -> None:
    run = experiment(*flags)
    assert (run.returncode, run.stdout) == (2, "")
    assert words in run.stderr
    assert "Traceback" not in run.stderr


def test_without_casadi_the_others_are_compared(experiment: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    small = ("--sizes", "2x2", "--runs", "1", "--modes", "ptz")
    run = experiment(*small)
    assert run.returncode == 0
    assert "camrig[ipopt]" in run.stderr
    assert "| ipopt |" not in run.stdout
    assert "Without ipopt: " in run.stdout
    by_name = experiment(*small, "--solvers", "hold,ipopt")
    assert by_name.returncode == 4
    assert "| hold |" in by_name.stdout
    assert "camrig[ipopt]" in by_name.stderr
    alone = experiment(*small, "--solvers", "ipopt")
    assert (alone.returncode, alone.stdout) == (2, "")


def test_an_interrupted_experiment_prints_nothing_and_exits_130() -> None:
    command = [sys.executable, "-m", "camrig", "experiment", "planner", "--runs", "10000", "--solvers", "camrig"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        program.stderr.readline()  # the note on threads: what follows are runs
        time.sleep(1.0)
        program.send_signal(signal.SIGINT)
        stdout, stderr = program.communicate(timeout=60.0)
    assert (program.returncode, stdout) == (130, "")
    assert "Traceback" not in stderr
