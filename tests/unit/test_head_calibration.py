"""A head that its file knows next to nothing of is calibrated in simulated time; what can go wrong has a name."""

import math
from typing import Any

import numpy as np
import pytest

from camrig.clock import ManualClock
from camrig.errors import CamrigError, LinkLost, PartialError
from camrig.runtime import head_calibration
from camrig.runtime.head_bench import DoesNotGo, HeadBench, Interrupted
from camrig.runtime.head_calibration import rough_speeds, run_calibration
from camrig.runtime.head_survey import Place, Survey, Tell
from tests.head_stand import PAN_LIMITS_DEG, TILT_LIMITS_DEG, emulated, study_place
from tests.head_study import numbers, pointing_errors_deg, study
from tests.scripted_head import ScriptedEye, ScriptedHead


def test_everything_is_found_and_the_driver_points_well_with_it() -> None:
    result, rig, eye = study(5, anchored=True)
    assert [row for row in numbers(result) if row.off > row.bar] == []
    assert result.verdict == "green"
    assert result.moving_s < 240.0
    assert rig.motions()[-1] == "stop"
    low_deg, high_deg = np.min(eye.angles_deg, axis=0), np.max(eye.angles_deg, axis=0)
    assert all(low_deg >= [PAN_LIMITS_DEG[0], TILT_LIMITS_DEG[0]])
    assert all(high_deg <= [PAN_LIMITS_DEG[1], TILT_LIMITS_DEG[1]])
    errors = pointing_errors_deg(result, rig, 20, 5)
    assert errors.max() <= 0.1
    assert math.degrees(result.pointing_rad) == pytest.approx(float(np.sqrt(np.mean(errors**2))), abs=0.02)


@pytest.mark.parametrize(
    ("changed", "error", "said"),
    [
        ({"pan_limits_deg": (-175.0, 30.0)}, PartialError, "pan stands at .* a stop, a cable or a limit of its own"),
        ({"tags": {}}, PartialError, "sees no tag where it looks now"),
        ({"script": "from 15 to 60 silent"}, LinkLost, "unanswered"),
        ({"script": "at 15 unplug"}, LinkLost, "lost while"),
        ({"answers": "none"}, LinkLost, "does not answer"),
        ({"start_tilt_deg": 15.0}, PartialError, "sees no tag"),
        ({"start_tilt_deg": -84.5}, PartialError, "within 1 deg of a limit of its tilt, or beyond: turn it inwards"),
    ],
)
def test_trouble_is_named_and_leaves_the_head_stopped(
    changed: dict[str, Any], error: type[CamrigError], said: str
) -> None:
    tags = {"tags": changed.pop("tags")} if "tags" in changed else {}
    rig = emulated(1, {}, **changed)
    with pytest.raises(error, match=said):
        study(1, anchored=True, emulated_heads=rig, **tags)
    moved = [motion for motion in rig.motions() if motion != "stop"]
    assert not moved or not rig.line.faults.plugged or rig.motions()[-1] == "stop"


def test_who_asks_for_the_end_is_heard_at_once() -> None:
    rig = emulated(1, {})
    with pytest.raises(Interrupted):
        study(1, anchored=True, emulated_heads=rig, asked_to_end=lambda: rig.time.now_s() > 115.0)
    assert rig.motions()[-1] == "stop"
    assert rig.line.received[-1][0] < 115.5


def test_a_head_that_takes_no_positions_is_steered_by_its_speeds() -> None:
    rig = emulated(1, {}, absolute="ignored")
    with pytest.raises(Interrupted):
        study(1, anchored=True, emulated_heads=rig, asked_to_end=lambda: rig.time.now_s() > 145.0)
    driven = [motion for motion in rig.motions() if motion != "stop" and motion[4:8] not in ("004b", "004d")]
    assert [motion[4:12] for motion in driven[:8:2]] == ["00040100", "00040400", "00040d00", "00042600"]  # pan alone
    assert len(driven) > 20
    rig.time.sleep_s(1.0)  # it coasts
    stopped_deg = rig.truth_deg()
    rig.time.sleep_s(1.0)
    assert rig.truth_deg() == stopped_deg


@pytest.mark.parametrize("first", [True, False])
def test_only_a_head_that_goes_nowhere_at_all_is_tried_by_its_speeds(
    first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = ManualClock()
    head = ScriptedHead(clock)

    def jams(bench: HeadBench, place: Place, tell: Tell) -> Survey:
        bench.begin()
        head.stuck = first
        bench.go(0.1, -0.5)
        head.stuck = True
        bench.go(0.3, -0.5)
        raise AssertionError("it is stuck")

    monkeypatch.setattr(head_calibration, "survey", jams)
    bench = HeadBench("pt1", head, ScriptedEye(clock), clock, ())
    with pytest.raises(DoesNotGo, match="pan does not move when it is sent from"):
        run_calibration(bench, study_place(anchored=False), lambda _, __: None, lambda _: head)
    assert [step for step in head.turned if step != (0, 0)][:3] == ([(1, 0), (-1, 0), (4, 0)] if first else [])


def test_a_head_is_tried_by_its_speeds_within_its_limits_alone() -> None:
    clock = ManualClock()
    head = ScriptedHead(clock)
    bench = HeadBench("pt1", head, ScriptedEye(clock), clock, ())
    bench.begin()
    found = rough_speeds(bench, [(-0.01, 0.01), (-0.6, -0.4)])
    assert found is not None
    assert max(abs(pan) for pan, _ in head.been_rad) < 0.03
    assert all(-0.63 < tilt < -0.37 for _, tilt in head.been_rad)
