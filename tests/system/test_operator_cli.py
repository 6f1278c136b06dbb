"""The operator's commands as they are typed, against a desk that stands for a daemon."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from camrig.cli import operating
from camrig.cli.console import results
from camrig.cli.main import main
from camrig.clock import RealClock
from camrig.messages import DroneHealth, FlightState, HeadAim, LinkStatus, TargetStatus
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_socket import claimed, runtime_folder
from tests.operator_desk import Desk, refusal, target


class Done(NamedTuple):
    """What a run left; words as printed, whatever the line breaks."""

    code: object
    out: str
    err: str


Run = Callable[..., Done]


@pytest.fixture
def camrig(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the program in this process, not on a terminal."""
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    monkeypatch.setattr(results, "width", 160)

    def run(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["camrig", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(ended.value.code or 0, " ".join(printed.out.split()), " ".join(printed.err.split()))

    return run


@pytest.fixture
def desk() -> Iterator[Desk]:
    """Return what stands for a running daemon of the rig "lab"."""
    desk = Desk(now_s=RealClock().now_s())
    with claimed("lab", runtime_folder()) as listener, serving(listener, desk.operator(), lambda: None):
        yield desk


@pytest.mark.parametrize(
    "command",
    [["status"], ["hold"], ["resume"], ["scan"], ["land", "d1"], ["arm", "d1", "--yes"], ["hold", "--rig", "x"]],
)
def test_without_a_daemon_every_command_says_so(camrig: Run, command: list[str]) -> None:
    done = camrig(*command)
    assert (done.code, done.out) == (3, "")
    assert "start" in done.err
    assert "camrig run" in done.err


def test_hold_resume_and_scan(camrig: Run, desk: Desk) -> None:
    assert camrig("hold") == (0, "heads stopped: pt1, pt2; drones told to hold: d1", "")
    assert camrig("resume", "pt2") == (0, "may move: pt2", "")
    desk.link("pt1", LinkStatus.LOST, "no answer")
    resumed = camrig("resume", "--rig", "lab")
    assert resumed[:2] == (0, "may move: pt1, pt2")
    assert resumed.err == "pt1: link lost (no answer); it may move once it is up again"
    assert camrig("scan", "--socket", str(runtime_folder() / "lab.sock")) == (0, "scanning", "")
    assert desk.done == [("hold", ()), ("resume", ("pt2",)), ("resume", ("pt1", "pt2")), ("scan", ())]


def test_a_stop_that_did_not_arrive_is_exit_4(camrig: Run, desk: Desk) -> None:
    desk.link("pt1", LinkStatus.LOST, "no answer")
    done = camrig("hold")
    assert done.code == 4
    assert "no stop reached pt1: link lost (no answer)" in done.err


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["resume", "pt7"], "its heads are pt1, pt2"),
        (["arm", "d7", "--yes"], "its drones are d1"),
        (["land", "pt1"], "its drones are d1"),
        (["hold", "--rig", "lab", "--socket", "/x"], "give one of them"),
        (["status", "--rig", "a/b"], "cannot name a socket"),
    ],
)
def test_wrong_names_are_exit_2(camrig: Run, desk: Desk, command: list[str], says: str) -> None:
    done = camrig(*command)
    assert (done.code, desk.done) == (2, [])
    assert says in done.err


def test_arm_asks_a_person_first(camrig: Run, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    done = camrig("arm", "d1")
    assert (done.code, desk.done) == (2, [])
    assert "arming d1 makes its propellers turn: confirm on a terminal, or say --yes" in done.err

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    assert camrig("arm", "d1").code not in {0, None}
    assert desk.done == []
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    done = camrig("arm", "d1")
    assert done[:2] == (0, "d1: taking_off")
    assert "propellers will turn" in done.err
    assert desk.done == [("arm", ("d1",))]


def test_a_drone_that_is_not_fit_is_not_even_asked(camrig: Run, desk: Desk) -> None:
    """All reasons at once, each with its cure; nothing is ordered."""
    unfit = ("its battery is at 12 %, 30 % is the least; charge it", "parameter FS_GCS_ENABLE is 0, set it to 5 (land)")
    desk.health["d1"] = DroneHealth("passive", obeys=False, unfit=unfit)
    for command in ("arm", "takeoff", "resume"):
        done = camrig(command, "d1", *(["--yes"] if command != "resume" else []))
        assert done.code == 3
        assert all(reason in done.err for reason in unfit)
    assert desk.done == []


def test_a_drone_is_resumed_by_its_name_alone(camrig: Run, desk: Desk) -> None:
    desk.health["d1"] = DroneHealth("holding", obeys=False)
    assert camrig("resume", "d1") == (0, "d1: follows plans", "")
    assert camrig("resume", "pt1", "d1") == (0, "may move: pt1 d1: follows plans", "")
    assert desk.done == [("resume", ("d1",)), ("resume", ("pt1", "d1"))]


def test_status_says_why_a_drone_is_not_fit(camrig: Run, desk: Desk) -> None:
    desk.health["d1"] = DroneHealth(
        "holding",
        obeys=False,
        reason="no position from the autopilot for 0.5 s: it holds",
        unfit=("its estimator has no height; wait, or restart it",),
        advice=("parameter FENCE_ENABLE is 0, set it to 1",),
        battery=0.62,
        pose_age_s=0.04,
        software="PX4 1.17.0",
    )
    shown = camrig("status").out
    for words in ("held, battery 62 %, not fit to fly", "d1: not fit: its estimator has no height", "d1: better: para"):
        assert words in shown
    found = json.loads(camrig("status", "--json").out)["drones"]["d1"]
    assert (found["control"], found["activity"], found["fit"]) == ("held", "holding", False)
    assert found["said"] == "no position from the autopilot for 0.5 s: it holds"
    assert (found["battery_percent"], found["pose_age_s"], found["software"]) == (62, 0.04, "PX4 1.17.0")


def test_land_says_that_it_lands(camrig: Run, desk: Desk) -> None:
    assert camrig("land", "d1") == (0, "d1: landing", "")


def test_a_drone_that_refuses_to_be_armed_says_why(camrig: Run, desk: Desk) -> None:
    desk.now_s = RealClock().now_s() + 0.2
    desk.arming = refusal(desk.now_s)
    done = camrig("arm", "d1", "--yes")
    assert (done.code, done.out) == (3, "")
    assert "d1: drone d1 is not armed: battery at 12 %" in done.err


def test_a_drone_that_does_nothing_is_exit_3(camrig: Run, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operating, "FLIGHT_TIMEOUT_S", 0.6)
    desk.arming = refusal(desk.now_s - 20.0)  # told before, in the same words: not told again
    done = camrig("arm", "d1", "--yes")
    assert done.code == 3
    assert (
        "d1 does not obey: unknown 0.6 s after 'arm'; the last that was said of it: drone d1 is not armed" in done.err
    )
    desk.arming = FlightState.GROUND
    assert "d1 does not obey: ground" in camrig("arm", "d1", "--yes").err


def test_status_for_people_and_for_programs(camrig: Run, desk: Desk) -> None:
    desk.targets = (
        target("robot[1]", TargetStatus.TRACKED, desk.now_s - 0.5),
        target("robot2", TargetStatus.UNSEEN, float("-inf")),
    )
    desk.link("pt2", LinkStatus.LOST, "no answer")
    desk.events.latest = (refusal(desk.now_s - 3.0),)
    desk.statistics = {"pt1": {"losses": 2, "polls": 400, "answers": 398}}
    desk.aimed = {"pt1": HeadAim(0.1, -0.2)}
    shown = camrig("status").out
    assert "lab: scanning, 1 of 2 targets; no plan yet" in shown
    for words in ("robot[1]", "1.000, 2.000, 0.000", "20.0, 20.0, 20.0", "unseen", "pt2 │ lost │ held", "no answer"):
        assert words in shown
    for words in ("pt1 │ up │ aimed by an operator", "│ 2 │ 99.5 % of 400 │"):
        assert words in shown
    assert "3.0 s ago d1: drone d1 is not armed: battery at 12 %" in shown
    found = json.loads(camrig("status", "--json").out)
    assert (found["rig"], found["heads"]["pt2"]["link"]) == ("lab", "lost")
    assert Path(runtime_folder(), "lab.sock").is_socket()
