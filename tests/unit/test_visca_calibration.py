"""A VISCA head, which offers no steps of speed, is calibrated by its stops alone, in simulated time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camrig.runtime.head_bench import HeadBench
from camrig.runtime.head_calibration import run_calibration
from camrig_drivers.visca.head import ViscaHead
from camrig_drivers.visca.line import Line
from camrig_drivers.visca.section import ViscaSection
from camrig_drivers.visca.tuning import tuning
from tests.head_stand import CAMERA_M, StudyEye, study_place
from tests.visca_bench import AXES, SPEC, ViscaBench

TRUE = {
    "pan": {"deg_per_count": 0.0694, "sign": 1, "offset_deg": 3.0},
    "tilt": {"deg_per_count": 0.0694, "sign": -1, "offset_deg": -2.0},
}


def test_counts_signs_and_camera_are_found() -> None:
    bench = ViscaBench(
        axes=TRUE, start_pan_deg=20.0, start_tilt_deg=-50.0, backlash_deg=0.2, pan_limits_deg=(-160, 160)
    )
    section = ViscaSection.model_validate({"port": "/dev/none", "axes": AXES})
    wide = replace(SPEC, pan_limits_rad=(-math.pi, math.pi), tilt_limits_rad=(-math.pi, math.pi))
    line = Line(lambda: bench.transport, bench.clock, reply_timeout_s=0.2, gap_s=0.02)
    head = ViscaHead(wide, tuning.plain(section), line, bench.clock)
    eye = StudyEye(bench.clock, bench.line, np.random.default_rng(3))
    place = study_place(anchored=True)
    result = run_calibration(
        HeadBench("pt1", head, eye, bench.clock, place.sizes_m), place, lambda _, __: None, lambda _: head
    )
    written = tuning.changes(section, result.findings())
    for name, true in TRUE.items():
        assert written["axes", name, "sign"] == true["sign"]
        assert written["axes", name, "deg_per_count"] == pytest.approx(true["deg_per_count"], rel=1e-3)
        assert written["axes", name, "offset_deg"] == pytest.approx(true["offset_deg"], abs=0.05)
        assert written["axes", name, "backlash_deg"] == pytest.approx(0.2, abs=0.05)
    np.testing.assert_allclose(result.calibration.fit.model.T_mount_camera[:3, 3], CAMERA_M, atol=2e-3)
    assert result.grade == "absolute"
    assert result.start_s is None
