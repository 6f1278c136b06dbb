"""`camrig run` on real pictures of a room, carried by hand: one tag is the anchor, the others are the targets."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ANCHOR = 14
"""Of the 20 tags in the room the one that leaves most others placed from several pictures."""

RIG = """\
rig: room
space: {{floor_m: [[-10, -10], [10, 10]]}}
lenses:
  phone: {{size_px: [816, 612], fx: 765.0, fy: 764.2, cx: 393.7, cy: 304.7}}
cameras:
  - {{id: hand, lens: phone, source: {{driver: images, path: {folder}, fps: 4}}, mount: {{free: true}}}}
anchors:
  - {{id: {anchor}, size_m: 0.16, T_world_tag: {{position_m: [0, 0, 0], rpy_deg: [90, 0, 0]}}}}
targets:
{targets}
outputs: [{{driver: jsonl, path: "-", rate_hz: 20}}]
"""


def _rig(folder: Path) -> str:
    others = (tag for tag in range(20) if tag != ANCHOR)
    targets = "\n".join(f"  - {{id: tag{tag}, motion: static, tags: [{{id: {tag}, size_m: 0.16}}]}}" for tag in others)
    return RIG.format(folder=folder, anchor=ANCHOR, targets=targets)


def _run(config: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "camrig", "run", str(config), "--json"]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_walk_through_a_room_gives_fused_targets_and_their_spread(shared_data: Path, tmp_path: Path) -> None:
    config = tmp_path / "room.yaml"
    config.write_text(_rig(shared_data / "images" / "swatbotics_mapping"))
    done = _run(config)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    targets = {line["target"]: line for line in lines if "target" in line}
    # Tags 10, 12, 15, 16, 17, 18 share pictures with the anchor; a target never seen beside it is unknown, not guessed.
    assert set(targets) >= {"tag10", "tag12", "tag15", "tag16", "tag17"}
    assert not set(targets) & {"tag0", "tag1", "tag13", "tag19"}
    for line in targets.values():
        covariance = np.array(line["covariance_m2"])
        assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
        assert np.linalg.norm(line["position_m"]) < 8.0
    spread = [line for line in lines if "spread" in line]
    assert len(spread) == 1
    several = [row for row in spread[0]["spread"].values() if row["n"] >= 3]
    assert several
    assert max(row["rms_m"] for row in several) < 0.15


def test_the_end_of_the_pictures_is_a_clean_end(shared_data: Path, tmp_path: Path) -> None:
    config = tmp_path / "room.yaml"
    config.write_text(_rig(shared_data / "images" / "swatbotics_hallway"))
    done = _run(config)
    # Two of those five pictures are upright: another size than the lens is for, found before anything starts.
    assert done.returncode == 2
    assert "lens" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("damage", ["empty", "absent", "rubbish"])
def test_a_folder_that_is_no_camera_is_one_sentence(tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "pictures"
    if damage != "absent":
        folder.mkdir()
    if damage == "rubbish":
        (folder / "a.jpg").write_bytes(b"no picture at all")
    config = tmp_path / "room.yaml"
    config.write_text(_rig(folder))
    done = _run(config)
    assert done.returncode in {2, 3}
    assert "Traceback" not in done.stderr
    assert str(folder) in done.stderr
