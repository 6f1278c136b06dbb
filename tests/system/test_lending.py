"""What borrows a head of a running daemon: asks, waits, keeps, gives back."""

import threading
from pathlib import Path

import pytest

from camrig.cli import lending
from camrig.cli.lending import lent
from camrig.clock import ManualClock
from camrig.errors import InputError
from camrig.runtime.operator import Operator
from camrig.runtime.operator_client import ask
from camrig.runtime.operator_status import RecentEvents
from tests.operator_desk import Desk, serving_at
from tests.runtime_parts import until


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    tmp_path.chmod(0o700)
    monkeypatch.setattr(lending, "find_socket", lambda rig: tmp_path / f"{rig}.sock")
    return tmp_path


def test_a_head_is_borrowed_kept_and_given_back(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lending, "_RENEW_S", 0.01)
    desk = Desk()
    with serving_at(folder, Operator(desk, RecentEvents())), lent("lab", "pt1", ManualClock(100.0)) as taken_back:
        until(lambda: ("renew", ("pt1", "45.0")) in desk.done)
        assert not taken_back.is_set()
    assert desk.done[0] == ("lend", ("pt1", "45.0"))
    assert desk.done[-1] == ("lend", ("pt1", "0.0"))


def test_a_hold_takes_it_back_and_who_has_it_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lending, "_RENEW_S", 0.01)
    desk = Desk()
    operator = Operator(desk, RecentEvents())
    with serving_at(folder, operator), lent("lab", "pt1", ManualClock(100.0)) as taken_back:
        answer = operator.handle({"command": "hold"}, "me")
        assert answer == {"ok": True, "heads": ["pt2"], "drones": ["d1"], "lent": ["pt1"]}
        assert taken_back.wait(5.0)


def test_a_daemon_that_stalls_keeps_nobody_waiting(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lending, "_RENEW_S", 0.01)
    asked, answers = threading.Event(), threading.Event()

    def stalls(path: Path, request: dict[str, object]) -> dict[str, object]:
        if request.get("renew"):
            asked.set()
            assert answers.wait(10.0)
        return ask(path, request)

    monkeypatch.setattr(lending, "ask", stalls)
    with serving_at(folder, Operator(Desk(), RecentEvents())), lent("lab", "pt1", ManualClock(100.0)) as taken_back:
        assert asked.wait(5.0)
        assert not taken_back.is_set()  # whoever moves the head looks at it meanwhile, and goes on
        answers.set()


def test_a_head_that_the_daemon_does_not_have_is_named(folder: Path) -> None:
    operator = Operator(Desk(), RecentEvents())
    with (
        serving_at(folder, operator),
        pytest.raises(InputError, match="rig 'lab' has no head 'pt9'"),
        lent("lab", "pt9", ManualClock()),
    ):
        pass


def test_without_a_daemon_nothing_is_asked() -> None:
    with lent("no such rig", "pt1", ManualClock()) as taken_back:
        assert not taken_back.is_set()
