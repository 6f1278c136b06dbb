"""Cameras look round from their heads: what is read, and what a head that fails costs. Simulated time."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from camrig.clock import ManualClock
from camrig.config.rig_file import load_rig
from camrig.errors import HardwareError
from camrig.runtime import rig_survey
from camrig.runtime.head_bench import HeadBench
from camrig.runtime.rig_survey import RigSurvey
from tests.scripted_head import ScriptedEye, ScriptedHead

RIG = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [640, 360], fx: 450, fy: 450, cx: 320, cy: 180}
cameras:
  - {id: north, lens: lab, source: {driver: fake}, mount: {head: pt1}}
  - {id: south, lens: lab, source: {driver: fake}, mount: {head: pt2}}
heads:
  - {id: pt1, driver: fake, position_m: [1, 1, 2.8]}
  - {id: pt2, driver: fake, position_m: [4, 1, 2.8]}
"""


@pytest.fixture
def survey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[ScriptedHead], RigSurvey]:
    """Return what surveys the rig with a head of its own for pt1."""
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)

    @contextmanager
    def eye(config: object, name: str, clock: ManualClock) -> Iterator[ScriptedEye]:
        yield ScriptedEye(clock)

    def made(first: ScriptedHead) -> RigSurvey:
        heads = {"pt1": first, "pt2": ScriptedHead(first.clock)}
        monkeypatch.setattr(rig_survey, "make_devices", lambda config, group: heads)
        monkeypatch.setattr(rig_survey, "camera_eye", eye)
        stops = dict.fromkeys(heads, ((0.3, -0.7), (-0.2, -0.4)))
        return RigSurvey(load_rig(path), first.clock, stops, lambda: False, lambda _: None)

    return made


def test_a_head_is_where_its_driver_says_though_it_came_from_further(
    survey: Callable[[ScriptedHead], RigSurvey],
) -> None:
    shots, faults = survey(ScriptedHead(ManualClock())).shots()
    assert faults == []
    assert [shot.aim_rad for shot in shots] == 2 * [pytest.approx((0.3, -0.7)), pytest.approx((-0.2, -0.4))]


@pytest.mark.parametrize(
    ("trouble", "said"),
    [("stuck", "north: head pt1: its pan does not move"), ("dumb", "north: .* not told its tilt")],
)
def test_a_head_that_fails_is_named_and_the_others_go_on(
    survey: Callable[[ScriptedHead], RigSurvey], trouble: str, said: str
) -> None:
    head = ScriptedHead(ManualClock())
    setattr(head, trouble, True)
    shots, faults = survey(head).shots()
    assert [shot.camera_id for shot in shots] == ["south", "south"]
    (fault,) = faults
    assert re.match(said, fault)


def test_a_calibration_waits_for_both_axes() -> None:
    clock = ManualClock()
    bench = HeadBench("pt1", ScriptedHead(clock, dumb=True), ScriptedEye(clock), clock, ())
    with pytest.raises(HardwareError, match="head pt1 has not told its tilt for 3 s"):
        bench.begin()
