"""A head that tells nothing: its time model is measured in its own camera's pictures, in simulated time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.errors import PartialError
from camrig.runtime.head_blind import BlindBench, run_blind_calibration
from camrig_drivers.pelco_d.head import PelcoDHead
from camrig_drivers.pelco_d.section import PelcoDSection
from camrig_drivers.pelco_d.tuning import changes, plain
from tests.head_stand import PICTURES_LATE_S, START_S, StudyEye, emulated, study_place
from tests.simulated_line import SPEED_DEG_S, SimulatedHeads, spec

ROUGH = {"speeds": {1: 0.2, 63: 20.0}}
SECTION = PelcoDSection.model_validate(
    {
        "port": "/sim",
        "gap_s": 0.02,
        "grade": "open_loop",
        "axes": {"pan": ROUGH, "tilt": ROUGH},
        "open_loop": {"zero": {"by": "anchors"}},
    }
)


def _bench(rig: SimulatedHeads) -> BlindBench:
    wide = replace(spec("pt1"), pan_limits_rad=(-math.pi, math.pi), tilt_limits_rad=(-math.pi, math.pi))
    head = PelcoDHead(wide, plain(SECTION), rig.bus, rig.time)
    eye = StudyEye(rig.time, rig.line, np.random.default_rng(1))
    return BlindBench("pt1", head, eye, rig.time, study_place(anchored=False).sizes_m)


def test_speeds_and_dead_time_are_found_without_a_word_from_the_head() -> None:
    rig = emulated(1, {}, answers="none", start_pan_deg=35.0, start_tilt_deg=-55.0, backlash_deg=0.1)
    bench = _bench(rig)
    result = run_blind_calibration(bench, study_place(anchored=False), lambda _, __: None)
    assert [run.steps for run in bench.runs[:4]] == [(1, 0), (-1, 0), (-2, 0), (2, 0)]  # slowest first, either way
    found = result.findings()
    for axis in (found.pan, found.tilt):
        for step, speed in axis.speeds_rad_s.items():
            assert math.degrees(speed) == pytest.approx(SPEED_DEG_S * step / 63.0, rel=0.03)
        assert len(axis.speeds_rad_s) >= 4
        assert math.degrees(axis.acceleration_rad_s2 or 0.0) == pytest.approx(160.0, rel=0.15)
    assert (found.pan.drive, found.tilt.drive) == (1, -1)
    # By the pictures' stamps, which the rest of the rig goes by; and slow turns take some time to take up the play.
    assert found.start_s == pytest.approx(START_S + PICTURES_LATE_S, abs=0.015)
    written = changes(SECTION, found)
    assert written["axes", "tilt", "drive_sign"] == 1
    assert 0.0 < float(str(written["open_loop", "speed_sigma"])) < 0.03
    assert not any(path[-1] in ("scale", "offset_deg") for path in written)
    assert result.verdict == "amber"
    assert rig.motions()[-1] == "stop"


def test_a_picture_that_does_not_follow_is_named() -> None:
    rig = emulated(1, {}, answers="none", dead_bytes=62)
    with pytest.raises(PartialError, match="its picture does not turn when its pan is told to"):
        run_blind_calibration(_bench(rig), study_place(anchored=False), lambda _, __: None)
    assert rig.motions()[-1] == "stop"
