"""Pictures taken live: only where the board is still, sharp and somewhere new, until they are enough."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camrig.calibrate.boards import BoardView, parse_board
from camrig.calibrate.find_boards import find_board
from camrig.calibrate.intrinsics import Kind, calibrate_lens
from camrig.calibrate.live import STILL_S, Collector
from camrig.calibrate.shots import edge_width_px
from camrig.cli.live_shots import _panel, collect, live_shots
from camrig.cli.main import build
from camrig.clock import RealClock
from camrig.config.rig_file import RigConfig, load_rig
from camrig.errors import HardwareError, InputError
from camrig.geometry.lens import BrownLens
from camrig.interfaces import Found
from camrig.runtime.head_calibration import camera_eye
from camrig_emulators.fakes import FakeCamera
from tests.drawn_boards import BoardCamera, points_px

LENS = BrownLens((480, 360), (420.0, 420.5), (243.0, 176.0), (-0.2, 0.05, 0.0, 0.0))
BOARD = parse_board("charuco:7x5:40:30:4x4_1000")
RIG = """\
rig: lab
space: {floor_m: [[0, 0], [1, 1]]}
lenses: {own: {size_px: [480, 360], fx: 400, fy: 400, cx: 240, cy: 180}}
cameras: [{id: north, lens: own, source: {driver: fake, fps: 100}, mount: {fixed: {position_m: [0, 0, 2]}}}]
"""
EMULATED = RIG.replace("driver: fake, fps: 100", "driver: rendered") + "world: {driver: emulated}\n"


def test_a_camera_takes_one_picture_of_each_pose_that_is_held() -> None:
    camera, drawer = FakeCamera("north"), BoardCamera(LENS, BOARD)
    stamp_s = 10.0
    camera.open()
    for T in drawer.poses(8):
        image = drawer.draw(T)
        for _ in range(4):
            camera.push(image, stamp_s)
            stamp_s += 0.5 * STILL_S
        camera.push(np.full((360, 480), 110, np.uint8), stamp_s)
        stamp_s += 0.1
    camera.end()
    seen = collect(camera, LENS.size_px, BOARD, None, hidden=True)
    camera.close()
    assert len(seen.shots) == 8
    found = calibrate_lens(seen.shots, seen.board, seen.size_px, Kind.BROWN)
    assert found.lens.focal_px[0] == pytest.approx(420.0, abs=4.0 * found.sigma["fx"] + 1.0)


def test_nothing_is_taken_of_a_board_that_moves_or_is_blurred() -> None:
    drawer = BoardCamera(LENS, BOARD)
    collector = Collector(BOARD, LENS.size_px)
    T = next(drawer.poses(1))
    for step in range(6):
        moved = T.copy()
        moved[0, 3] += 0.01 * step
        image = drawer.draw(moved)
        view = find_board(image, BOARD)
        assert view is not None
        assert not collector.take(view, edge_width_px(image, view, BOARD), 0.3 * step)
        assert collector.says == "hold it still"
    still = BoardView(np.arange(24), points_px(LENS, BOARD, T))
    assert not collector.take(still, 9.0, 5.0)
    assert not collector.take(still, 9.0, 6.0)
    assert "blurred" in collector.says
    assert not collector.take(None, math.inf, 7.0)
    assert collector.says == "no board in view"


def test_pictures_are_enough_when_the_sigma_flattens_and_the_panel_says_what_is_missing() -> None:
    drawer = BoardCamera(LENS, BOARD)
    random = np.random.default_rng(4)
    collector = Collector(BOARD, LENS.size_px)
    stamp_s, said = 0.0, set()
    for T in drawer.poses(60):
        where = points_px(LENS, BOARD, T)
        inside = ((where > 2) & (where < np.array(LENS.size_px) - 3)).all(axis=-1)
        view = BoardView(np.flatnonzero(inside), where[inside] + random.normal(0.0, 0.1, (int(inside.sum()), 2)))
        for _ in range(3):
            stamp_s += STILL_S
            collector.take(view, 2.0, stamp_s)
        said.add(collector.next_pose)
        assert "next: hold the board" in str(_panel(collector).renderables[1])
        if collector.is_enough:
            break
    assert 12 <= len(collector.shots) <= 40
    assert len(said) >= 3
    assert collector.gauges.coverage >= 0.75


def test_a_camera_that_shows_no_board_or_nothing_is_told_in_a_sentence(tmp_path: Path) -> None:
    camera = FakeCamera("north")
    camera.open()
    camera.push(np.full((360, 480), 110, np.uint8), 1.0)
    camera.end()
    with pytest.raises(InputError, match="no picture of charuco:7x5:40:30:4x4_1000 was taken: no board in view"):
        collect(camera, LENS.size_px, BOARD, None, hidden=True)
    (tmp_path / "rig.yaml").write_text(EMULATED)
    with pytest.raises(InputError, match="only while it runs: use --from-images"):
        live_shots(load_rig(tmp_path / "rig.yaml"), "north", BOARD, None, hidden=True)


def focusing(config: RigConfig, *, value: bool) -> RigConfig:
    """Return the rig with a camera that says whether it focuses by itself."""
    told = Found("/dev/v4l/by-id/eye", "eye", {}, facts={
        "names": ["/dev/v4l/by-id/eye", "/dev/video0"],
        "controls": {"focus_automatic_continuous": {"kind": "switch", "value": value}},
    })  # fmt: skip
    source = config.devices["cameras"]["north"]
    driver = replace(source.driver, discover=lambda: [told])
    source = replace(source, driver=driver, raw={**source.raw, "device": "/dev/video0"})
    return replace(config, devices={**config.devices, "cameras": {"north": source}})


def test_a_camera_that_focuses_by_itself_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    config = focusing(load_rig(tmp_path / "rig.yaml"), value=True)
    with pytest.raises(InputError, match=r"focuses by itself.*lock: \[focus\]"):
        live_shots(config, "north", BOARD, None, hidden=True)


@pytest.mark.parametrize("value", [True, False])
def test_no_head_is_calibrated_through_a_camera_that_focuses_by_itself(tmp_path: Path, *, value: bool) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    config = focusing(load_rig(tmp_path / "rig.yaml"), value=value)
    with camera_eye(config, "north", RealClock()) as eye:
        refused = pytest.raises(InputError, match="'north' focuses by itself") if value else nullcontext()
        with refused:
            while not eye.take():
                time.sleep(0.01)


def test_a_camera_that_gives_no_picture_is_a_fault_of_hardware(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camrig.cli.live_shots._PATIENCE_S", 0.01)
    camera = FakeCamera("north")
    camera.open()
    with pytest.raises(HardwareError, match="gave no picture"):
        collect(camera, LENS.size_px, BOARD, None, hidden=True)


def test_the_command_waits_for_a_board_only_so_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camrig.cli.live_shots._BOARD_S", 0.2)
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    with pytest.raises(InputError, match="was taken: no board in view"):
        build(("calibrate",))(
            ["calibrate", "intrinsics", str(rig), "north", "--board", "charuco:7x5:40:30:4x4", "--json"],
            standalone_mode=False,
        )
