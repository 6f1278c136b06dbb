"""What borrows a head of a running daemon: asks, waits, keeps, gives back."""

from pathlib import Path

import pytest

from camrig.cli import lending
from camrig.cli.lending import lent
from camrig.clock import ManualClock
from camrig.errors import InputError
from camrig.runtime.operator import Operator
from camrig.runtime.operator_status import RecentEvents
from tests.operator_desk import Desk, serving_at


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    tmp_path.chmod(0o700)
    monkeypatch.setattr(lending, "find_socket", lambda rig: tmp_path / f"{rig}.sock")
    return tmp_path


def test_a_head_is_borrowed_kept_and_given_back(folder: Path) -> None:
    desk, clock = Desk(), ManualClock(100.0)
    with serving_at(folder, Operator(desk, RecentEvents())), lent("lab", "pt1", clock) as keep:
        keep()
        assert desk.done == [("lend", ("pt1", "45.0"))]
        clock.advance(20.0)
        keep()
        keep()
        assert desk.done == [("lend", ("pt1", "45.0"))] * 2
    assert desk.done[-1] == ("lend", ("pt1", "0.0"))


def test_a_head_that_the_daemon_does_not_have_is_named(folder: Path) -> None:
    operator = Operator(Desk(), RecentEvents())
    with (
        serving_at(folder, operator),
        pytest.raises(InputError, match="rig 'lab' has no head 'pt9'"),
        lent("lab", "pt9", ManualClock()),
    ):
        pass


def test_without_a_daemon_nothing_is_asked() -> None:
    with lent("no such rig", "pt1", ManualClock()) as keep:
        keep()
