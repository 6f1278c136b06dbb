"""What a head's calibration answers and writes: JSON, tables, a page, and a file that loads."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camrig.calibrate.head import HeadCalibration, calibrate_head
from camrig.calibrate.head_result import HeadResult
from camrig.calibrate.head_timing import AxisTiming
from camrig.cli.calibrate_head_answer import as_json, axis_rows, facts, page, print_result
from camrig.cli.console import finite
from camrig.config.amend import amend_rig
from camrig.config.head_changes import bias_deg, head_changes
from camrig.config.rig_file import load_rig
from camrig.messages import AxisFindings, HeadFindings
from camrig.report.calibration import report_html
from camrig.rig import HeadMount
from tests.head_shots import AIMS_DEG, ROUGH, TAGS, seen_from
from tests.head_stand import SIZE_M
from tests.simulated_room import LENS

RIG = """\
rig: one-head
space: {floor_m: [[0, 0], [5, 4]]}
lenses:
  lab: {model: brown, size_px: [1280, 720], fx: 1050.0, fy: 1050.0, cx: 640.0, cy: 360.0}
cameras:
  - {id: eye, lens: lab, source: {driver: fake}, mount: {head: pt1}}
heads:
  - id: pt1           # in the corner
    driver: pelco_d
    port: /dev/ttyUSB0
    position_m: [1, 1, 2.8]
"""


pytestmark = pytest.mark.usefixtures("picture_fonts")


@pytest.fixture(scope="module")
def calibrated() -> HeadCalibration:
    return calibrate_head(seen_from(AIMS_DEG), LENS, dict.fromkeys(TAGS, SIZE_M), ROUGH, TAGS)


@pytest.fixture(scope="module")
def result(calibrated: HeadCalibration) -> HeadResult:
    return HeadResult(calibrated, (None, None), (0.012, 0.001), "absolute", 120.0, (0.1, 0.2, 0.4))


def test_what_is_written_loads_and_says_what_was_found(result: HeadResult, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    amend_rig(path, head_changes(load_rig(path), "pt1", "eye", result))
    written = load_rig(path)
    assert "# in the corner" in path.read_text()
    model, rig = result.calibration.fit.model, written.rig
    kinematics, mount = rig.heads["pt1"].kinematics, rig.cameras["eye"].mount
    assert isinstance(mount, HeadMount)
    for found, loaded in (
        (model.T_world_base, kinematics.T_world_base),
        (model.T_arm_tilt, kinematics.T_arm_tilt),
        (model.T_mount_camera, mount.T_mount_camera),
    ):
        np.testing.assert_allclose(loaded, found, atol=1e-5)
    section = written.devices["heads"]["pt1"].section
    # The driver's default counts -1 times what the head says.
    assert section.axes.pan.sign * section.axes.pan.scale == pytest.approx(1.36, abs=2e-3)
    assert section.axes.tilt.sign * section.axes.tilt.scale == pytest.approx(-0.9, abs=2e-3)
    assert section.axes.tilt.offset_deg == pytest.approx(math.degrees(-0.05), abs=0.05)
    assert section.report_age_s == 0.012
    assert rig.heads["pt1"].bias_sigma_rad == pytest.approx(math.radians(bias_deg(result)), rel=0.01)


def test_json_says_every_figure_with_its_unit(result: HeadResult) -> None:
    answer = json.loads(json.dumps(finite(as_json("pt1", "eye", result, {("heads", "pt1", "x"): 1.0}, None))))
    assert answer["verdict"] == "green"
    assert answer["axes"]["pan"]["scale"] == pytest.approx(-1.36, abs=2e-3)
    assert 0.0 < answer["axes"]["tilt"]["backlash_sigma_deg"] < 0.1
    assert answer["T_arm_tilt"]["position_m"][0] == pytest.approx(0.02, abs=2e-3)
    assert answer["changes"] == {"heads.pt1.x": 1.0}
    assert answer["tags"].keys() == set(result.calibration.fit.views.tags)
    assert answer["start_s"] is None


def test_people_and_the_page_are_told_the_same(result: HeadResult, capsys: pytest.CaptureFixture[str]) -> None:
    print_result("pt1", result, {}, written=False)
    said = capsys.readouterr().out
    for name, _, _ in axis_rows(result):
        assert name in said
    html = report_html(page("pt1", Path("rig.yaml"), result, {}))
    assert all(name in said and text in said and text in html for name, text in facts(result))
    assert "bias" not in html


def test_what_a_head_was_steered_with_stays_in_what_is_written(result: HeadResult, tmp_path: Path) -> None:
    """Its pan turned against the file's drive_sign; turned the other way, it then went where it was told."""
    factor = result.calibration.fit.model.axes[0].factor
    none = np.zeros(0)
    rates = {step: math.copysign(0.1, step * factor) for step in (20, -20)}
    timing = AxisTiming((), rates, dict.fromkeys(rates, 1e-3), 0.1, 0.01, 0.1, 2.0, 0.1, none, none)
    against = AxisFindings(1.0, 0.0, 0.0, drive=-1, speeds_rad_s={5: 0.02, 20: 0.1})
    rough = HeadFindings(against, replace(against, drive=1), "servo")
    steered = replace(result, timings=(timing, None), grade="servo", driven_by=rough)
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    before = load_rig(path).devices["heads"]["pt1"].section.axes
    amend_rig(path, head_changes(load_rig(path), "pt1", "eye", steered))
    section = load_rig(path).devices["heads"]["pt1"].section
    assert section.axes.pan.drive_sign == -before.pan.drive_sign
    assert section.axes.tilt.drive_sign == before.tilt.drive_sign
    assert list(section.axes.pan.speeds) == [20]
    assert list(section.axes.tilt.speeds) == [5, 20]
    assert section.grade.value == "velocity"
