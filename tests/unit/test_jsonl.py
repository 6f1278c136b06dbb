"""Targets and events as JSON lines: which keys, how often, and what cannot be written is one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from camrig.errors import HardwareError, InputError
from camrig.messages import Event, Level, TargetStatus
from camrig.outputs.jsonl import JsonlSection, JsonlSink, driver
from tests.runtime_parts import one_head_rig, published, target

UNSEEN, LOST = TargetStatus.UNSEEN, TargetStatus.LOST

Line = dict[str, object]


@pytest.fixture
def sink(tmp_path: Path) -> Iterator[Callable[..., JsonlSink]]:
    """Return ``open(**section)``: an open sink, by default to ``targets.jsonl`` in the test's folder."""
    opened: list[JsonlSink] = []

    def open_sink(**section: object) -> JsonlSink:
        found = driver.make(driver.section.model_validate({"path": str(tmp_path / "targets.jsonl"), **section}))
        assert isinstance(found, JsonlSink)
        found.open(one_head_rig())
        opened.append(found)
        return found

    yield open_sink
    for found in opened:
        found.close()
        found.close()


def lines(folder: Path) -> list[Line]:
    return [json.loads(line, parse_constant=_no_json) for line in (folder / "targets.jsonl").read_text().splitlines()]


def _no_json(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def test_a_target_is_a_line_with_units_clock_and_frame(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    sink().write(published(12.0, target("robot1", (1.0, 2.0, 0.123456), stamp_s=12.0)))
    (line,) = lines(tmp_path)
    utc = datetime.fromisoformat(str(line.pop("utc")))
    assert utc.tzinfo is UTC
    assert line == {
        "rig": "lab",
        "target": "robot1",
        "status": "tracked",
        "stamp_s": 12.0,
        "clock": "monotonic",
        "frame": "world",
        "position_m": [1.0, 2.0, 0.12346],
        "velocity_m_s": [0.1, 0.0, 0.0],
        "covariance_m2": [[0.0004, 0.0, 0.0], [0.0, 0.0004, 0.0], [0.0, 0.0, 0.0004]],
        "yaw_rad": 0.0,
        "seen_by": ["north"],
        "age_s": 0.05,
        "quality_m": 0.002,
        "planned_sigma_m": None,
        "innovation": None,
    }


def test_what_was_planned_stands_beside_what_was_achieved(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    planned = np.diag([0.001**2, 0.002**2, 0.003**2])
    sink().write(published(0.0, replace(target("robot1"), planned_covariance_m2=planned, innovation=0.81234)))
    (line,) = lines(tmp_path)
    assert line["planned_sigma_m"] == [0.001, 0.002, 0.003]
    assert line["innovation"] == 0.812


def test_the_wall_clock_goes_with_the_stamp(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    found = sink(rate_hz=100)
    for stamp_s in (5.0, 65.0):
        found.write(published(stamp_s, target("robot1", stamp_s=stamp_s)))
    first, second = (datetime.fromisoformat(str(line["utc"])) for line in lines(tmp_path))
    assert (second - first).total_seconds() == pytest.approx(60.0, abs=0.1)


def test_lost_targets_are_written_and_unseen_ones_are_not(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    sink().write(published(0.0, target("robot1"), target("robot2", status=LOST), target("robot3", status=UNSEEN)))
    assert [(line["target"], line["status"]) for line in lines(tmp_path)] == [("robot1", "tracked"), ("robot2", "lost")]


@pytest.mark.parametrize(("rate_hz", "at_most"), [(10.0, 10), (2.0, 2), (100.0, 50)])
def test_no_more_is_written_than_the_rate_allows(
    sink: Callable[..., JsonlSink], tmp_path: Path, rate_hz: float, at_most: int
) -> None:
    found = sink(rate_hz=rate_hz)
    for tick in range(50):  # one second of control
        found.write(published(tick / 50, target("robot1", stamp_s=tick / 50)))
    stamps_s = [line["stamp_s"] for line in lines(tmp_path)]
    assert 0.8 * at_most <= len(stamps_s) <= at_most
    assert stamps_s[0] == 0.0


def test_every_event_is_written_at_once(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    found = sink(rate_hz=0.1)
    for tick in range(3):
        event = Event(tick / 50, Level.WARNING, "north", f"link lost {tick}")
        found.write(published(tick / 50, target("robot1"), events=(event,)))
    events = [line for line in lines(tmp_path) if "event" in line]
    assert [line["event"] for line in events] == ["link lost 0", "link lost 1", "link lost 2"]
    assert set(events[0]) == {"rig", "event", "about", "level", "stamp_s", "utc"}
    assert (events[0]["about"], events[0]["level"]) == ("north", "warning")
    assert len([line for line in lines(tmp_path) if "target" in line]) == 1


def test_a_file_is_continued(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    sink().write(published(0.0, target("robot1")))
    sink().write(published(0.0, target("robot2")))
    assert [line["target"] for line in lines(tmp_path)] == ["robot1", "robot2"]


def test_a_dash_is_standard_output_which_stays_open(
    sink: Callable[..., JsonlSink], capsys: pytest.CaptureFixture[str]
) -> None:
    found = sink(path="-")
    found.write(published(0.0, target("robot1")))
    found.close()
    print("still open")
    line, last = capsys.readouterr().out.splitlines()
    assert json.loads(line)["target"] == "robot1"
    assert last == "still open"


def test_nothing_is_written_after_closing(sink: Callable[..., JsonlSink], tmp_path: Path) -> None:
    found = sink()
    found.close()
    found.write(published(0.0, target("robot1")))
    assert lines(tmp_path) == []


@pytest.mark.parametrize("place", ["no/such/folder/x.jsonl", "."])
def test_a_path_that_cannot_be_written_is_bad_input(sink: Callable[..., JsonlSink], tmp_path: Path, place: str) -> None:
    with pytest.raises(InputError, match=r"output '.*' cannot be written: ") as caught:
        sink(path=str(tmp_path / place))
    assert str(tmp_path) in str(caught.value)


def test_a_disk_that_fills_up_is_one_sentence(sink: Callable[..., JsonlSink]) -> None:
    found = sink(path="/dev/full")
    with pytest.raises(HardwareError, match="output '/dev/full' cannot be written any more: No space left on device"):
        found.write(published(0.0, target("robot1")))


@pytest.mark.parametrize("section", [{"rate_hz": 0.0}, {"rate_hz": 101.0}, {"rate": 5.0}, {"path": 3}])
def test_a_wrong_section_is_refused(section: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        JsonlSection.model_validate(section)
