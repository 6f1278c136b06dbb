"""What a VISCA head's section refuses, and the sentences it refuses with."""

from __future__ import annotations

from pathlib import Path

import pytest

from camrig.config.rig_file import load_rig
from camrig.errors import ConfigError

RIG = """\
rig: lab
space: {floor_m: [[0, 0], [5, 3]]}
lenses:
  lab: {size_px: [320, 240], fx: 400, fy: 400, cx: 160, cy: 120}
cameras:
  - {id: north, lens: lab, source: {driver: fake}, mount: {head: pt1}}
heads:
"""
AXES = "axes: {pan: {deg_per_count: 0.075, sign: -1}, tilt: {deg_per_count: 0.075, sign: 1}}"
PLACE = "driver: visca, position_m: [1, 1, 2.8]"


def head(name: str, keys: str, axes: str = AXES) -> str:
    return f"  - {{id: {name}, {PLACE}, {keys}, {axes}}}\n"


@pytest.mark.parametrize(
    ("heads", "says"),
    [
        (head("pt1", "port: /dev/ttyUSB0, address: 8"), "address: input should be less than or equal to 7; got 8"),
        (head("pt1", "port: /dev/ttyUSB0, axes: {}", "tilt_deg: [-90, 0]"), "axes.pan: is missing"),
        (head("pt1", "port: 'tcp://1.2.3.4:5678'"), "must be a serial device or udpout://host:port"),
        (head("pt1", "port: 'udpout://1.2.3.4'"), "must be a serial device or udpout://host:port"),
        (head("pt1", "port: 'udpout://1.2.3.4:1259', address: 2"), "a head on UDP has address 1, not 2"),
        (
            head("pt1", "port: /dev/ttyUSB0") + head("pt2", "port: /dev/ttyUSB0"),
            "address 1 is taken by head pt1 on the same port; give each its own, 1..7",
        ),
        (
            head("pt1", "port: /dev/ttyUSB0") + head("pt2", "port: /dev/ttyUSB0, address: 2, baud: 38400"),
            "is 38400 here and 9600 for head pt1 on the same port",
        ),
        (
            head("pt1", "port: 'udpout://1.2.3.4:1259'") + head("pt2", "port: 'udpout://1.2.3.4:1259'"),
            "udpout://1.2.3.4:1259 is already the port of head pt1",
        ),
        (
            head("pt1", "port: /dev/ttyUSB0", AXES.replace("0.075", "0.001")),
            "limits reach beyond the -32.8..32.8 deg that its counts can say",
        ),
        (head("pt1", "port: /dev/ttyUSB0, pan_deg: [20, -20]"), "pan_deg"),
    ],
)
def test_faults_are_told_in_sentences(tmp_path: Path, heads: str, says: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG + heads)
    with pytest.raises(ConfigError) as refused:
        load_rig(path)
    assert says in str(refused.value)
