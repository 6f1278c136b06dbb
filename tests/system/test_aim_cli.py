"""``camrig aim`` as it is typed, against a desk that stands for a daemon."""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest
from rich.console import Console

from camrig.cli import aim as aim_module
from camrig.cli.aim_watch import Look, judge
from camrig.cli.main import main
from camrig.clock import RealClock
from camrig.messages import HeadAim, LinkStatus
from camrig.report.terminal_head import HeadPicture, head_view
from camrig.runtime.operator_server import serving
from camrig.runtime.operator_socket import claimed, runtime_folder
from tests.operator_desk import Desk


class Done(NamedTuple):
    """What a run left."""

    code: object
    out: str
    err: str


class MovingDesk(Desk):
    """A desk whose heads reach an aim ``lag`` looks after it was given, unless they are ``stuck``."""

    lag = 10**6
    stuck = False
    meanwhile: Callable[[MovingDesk], None] | None = None

    def aim(self, head: str, aim: HeadAim) -> None:
        super().aim(head, aim)
        self.lag = 4

    def view(self):  # type: ignore[no-untyped-def]
        self.now_s = RealClock().now_s()
        self.lag -= 1
        if self.lag == 0 and self.meanwhile is not None:
            self.meanwhile(self)
        for name, aim in self.aimed.items():
            there = self.lag <= 0 and not self.stuck
            self.points(name, aim.pan_rad if there else 0.0, aim.tilt_rad if there else -0.1)
        return super().view()


@pytest.fixture
def desk() -> Iterator[MovingDesk]:
    desk = MovingDesk(now_s=RealClock().now_s())
    with claimed("lab", runtime_folder()) as listener, serving(listener, desk.operator(), lambda: None):
        yield desk


@pytest.fixture
def camrig(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run the program in this process."""

    def run(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["camrig", "aim", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(ended.value.code or 0, printed.out, " ".join(printed.err.split()))

    return run


Run = Callable[..., Done]


def test_it_waits_until_the_head_is_there(camrig: Run, desk: MovingDesk) -> None:
    done = camrig("pt1", "--pan-deg", "10", "--tilt-deg", "-20")
    assert done.code == 0
    assert done.out.startswith("pt1: pan 10.00 deg, tilt -20.00 deg after")
    assert "`camrig resume pt1` gives it back" in done.out
    assert desk.done == [("aim", ("pt1",))]


def test_for_programs_it_answers_with_one_object(camrig: Run, desk: MovingDesk) -> None:
    found = json.loads(camrig("pt1", "--pan-deg", "10", "--tilt-deg", "-20", "--json").out)
    assert found["lasted_s"] > 0.0
    assert found.items() >= {"head": "pt1", "control": "operator", "pan_deg": 10.0, "tilt_deg": -20.0}.items()
    assert found.items() >= {"wanted_pan_deg": 10.0, "wanted_tilt_deg": -20.0, "arrived": True}.items()


@pytest.mark.parametrize(
    ("meanwhile", "says"),
    [
        (lambda desk: desk.link("pt1", LinkStatus.LOST, "no answer"), "its link is lost (no answer); it is not moved"),
        (lambda desk: desk.aimed.clear(), "somebody took it from this aim: it follows plans again"),
        (lambda desk: desk.aimed.update(pt1=HeadAim(1.0, -1.0)), "somebody took it from this aim: it has another aim"),
    ],
    ids=["link", "resume", "aim"],
)
def test_it_says_why_the_head_is_not_there(
    camrig: Run, desk: MovingDesk, meanwhile: Callable[[MovingDesk], None], says: str
) -> None:
    desk.stuck, desk.meanwhile = True, meanwhile
    done = camrig("pt1", "--pan-deg", "10", "--tilt-deg", "-20", "--json")
    assert done.code == 3
    assert f"pt1 is not there: {says}" in done.err
    assert json.loads(done.out)["arrived"] is False


def test_it_does_not_wait_for_ever(camrig: Run, desk: MovingDesk) -> None:
    desk.stuck = True
    done = camrig("pt1", "--pan-deg", "10", "--tilt-deg", "-20", "--timeout-s", "0.5")
    assert (done.code, done.out) == (3, "")
    assert "it is at pan 0.00 deg, tilt -5.73 deg, off by 10.00 and -14.27 deg" in done.err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["pt9", "--pan-deg", "1"], 2, "its heads are pt1, pt2"),
        (["pt9"], 2, "its heads are pt1, pt2"),
        (["pt1", "--pan-deg", "175", "--tilt-deg", "0"], 2, "outside its limits, -171.887 to 171.887 deg"),
        (["pt1", "--pan-deg", "10"], 3, "give both its pan and its tilt"),
    ],
)
def test_mistakes_move_nothing(camrig: Run, desk: MovingDesk, arguments: list[str], code: int, says: str) -> None:
    done = camrig(*arguments)
    assert (done.code, done.out, desk.done) == (code, "", [])
    assert says in done.err


def test_without_an_aim_it_only_tells_where_the_head_points(camrig: Run, desk: MovingDesk) -> None:
    assert camrig("pt2").out == "pt2: position unknown; link up, held\n"
    assert desk.done == []


def test_interrupted_it_says_that_the_head_goes_on(
    camrig: Run, desk: MovingDesk, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = threading.Event()
    asked.set()
    verdict = aim_module._follow(runtime_folder() / "lab.sock", "pt1", (1.0, 1.0), 0.3, 5.0, asked, lambda _: None)
    assert verdict.reason is not None  # nobody gave that aim
    desk.aimed["pt1"], desk.stuck = HeadAim(math.radians(1.0), math.radians(1.0)), True
    verdict = aim_module._follow(runtime_folder() / "lab.sock", "pt1", (1.0, 1.0), 0.3, 5.0, asked, lambda _: None)
    assert (verdict.arrived, verdict.reason) == (False, None)


def look(stamp_s: float, present_deg: tuple[float, float] | None, sigma_deg: tuple[float, float] = (0.0, 0.0)) -> Look:
    limits_deg = ((-170.0, 170.0), (-90.0, 10.0))
    return Look("pt1", stamp_s, "up", "", "operator", present_deg, sigma_deg, (10.0, -20.0), limits_deg)


@pytest.mark.parametrize(
    ("looks", "arrived"),
    [
        ([look(0.0, (10.0, -20.0)), look(0.4, (10.1, -20.1))], True),
        ([look(0.0, (10.0, -20.0))], False),  # it may be passing by
        ([look(0.0, (9.0, -20.0)), look(0.1, (9.5, -20.0)), look(0.35, (10.0, -20.0))], False),
        ([look(0.0, (11.0, -20.0)), look(0.4, (11.0, -20.0))], False),
        ([look(0.0, (11.0, -20.0), (0.4, 0.0)), look(0.4, (11.0, -20.0), (0.4, 0.0))], True),  # as well as is known
        ([look(0.0, (15.0, -20.0), (9.0, 0.0)), look(0.4, (15.0, -20.0), (9.0, 0.0))], False),
        ([look(0.0, None), look(0.4, (10.0, -20.0))], True),
        ([look(0.2, None), look(0.4, (10.0, -20.0))], False),
    ],
)
def test_there_means_near_and_still(looks: list[Look], arrived: bool) -> None:
    verdict = judge(looks, (10.0, -20.0), 0.3, 0.0, 30.0)
    assert (verdict is not None and verdict.arrived) == arrived


class TestPicture:
    """What the person on the ladder sees."""

    def drawn(self, **changed: object) -> list[str]:
        parts = {"present_deg": (0.0, -40.0), "sigma_deg": (0.03, 0.03), "wanted_deg": (85.0, -40.0), **changed}
        picture = HeadPicture("pt1", (-170.0, 170.0), (-90.0, 10.0), state="link up", **parts)  # type: ignore[arg-type]
        console = Console(width=80, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
        console.print(head_view(picture))
        console.file.close()
        return console.export_text().splitlines()

    def test_left_is_left_and_it_fits_a_small_terminal(self) -> None:
        lines = self.drawn()
        row = next(line for line in lines if "X" in line and "." in line)
        assert row.index("X") < row.index("O") == len(row) // 2 - 0
        assert len(lines) <= 24
        assert any("85.00 deg left" in line for line in lines)

    def test_arrived_and_unknown_are_told(self) -> None:
        arrived = "\n".join(self.drawn(wanted_deg=(0.0, -40.0)))
        assert "@" in arrived
        assert arrived.count("   there") >= 2
        unknown = "\n".join(self.drawn(present_deg=None))
        assert unknown.count("unknown") == 2
        assert unknown.count("X wanted") == 1

    def test_what_lies_outside_the_limits_is_not_drawn(self) -> None:
        assert not any(
            "O" in line for line in self.drawn(present_deg=(0.0, 30.0)) if "." in line and "here" not in line
        )
