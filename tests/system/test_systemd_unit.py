"""The unit file is accepted by systemd itself, and is tight."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNIT = Path(__file__).parents[2] / "systemd" / "camrig.service"

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def _analyse(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, check=False, timeout=60)


def test_the_unit_verifies(tmp_path: Path) -> None:
    program = shutil.which("true")
    unit = tmp_path / "camrig.service"  # the program's place is the host's; everything else is verified as it stands
    unit.write_text(UNIT.read_text().replace("/opt/camrig/bin/camrig", str(program)))
    found = _analyse("verify", "--man=no", str(unit))
    assert found.returncode == 0, found.stderr
    assert "camrig.service" not in found.stderr


def test_the_service_is_locked_in() -> None:
    found = _analyse("security", "--offline=yes", str(UNIT))
    exposure = re.search(r"exposure level for camrig.service: ([\d.]+)", found.stdout)
    assert exposure is not None, found.stdout + found.stderr
    assert float(exposure[1]) < 3.0


def test_stopping_the_heads_is_the_last_word() -> None:
    assert re.search(r"^ExecStopPost=.*camrig stop ", UNIT.read_text(), re.MULTILINE)
