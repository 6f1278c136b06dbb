"""The unit files are accepted by systemd itself, are tight, and are put in place by ``camrig install-service``."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from camrig.errors import InputError
from camrig.runtime import service_files

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNITS = ("camrig.service", "camrig@.service")
INSTALLED = {
    "etc/systemd/system/camrig.service",
    "etc/systemd/system/camrig@.service",
    "etc/sysusers.d/camrig.conf",
    "etc/udev/rules.d/60-camrig.rules",
}

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed (apt-get install systemd)"
)


def _analyse(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, check=False, timeout=60)


def _install(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "camrig", "install-service", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


@needs_systemd
@pytest.mark.parametrize("name", UNITS)
def test_the_unit_verifies(tmp_path: Path, name: str) -> None:
    program = shutil.which("true")
    unit = tmp_path / name  # the program's place is the host's; everything else is verified as it stands
    unit.write_text((SYSTEMD / name).read_text().replace("/opt/camrig/bin/camrig", str(program)))
    found = _analyse("verify", "--man=no", str(unit))
    assert found.returncode == 0, found.stderr
    assert "camrig" not in found.stderr


@needs_systemd
@pytest.mark.parametrize("name", UNITS)
def test_the_service_is_locked_in(name: str) -> None:
    found = _analyse("security", "--offline=yes", str(SYSTEMD / name))
    exposure = re.search(r"exposure level for camrig\S*: ([\d.]+)", found.stdout)
    assert exposure is not None, found.stdout + found.stderr
    assert float(exposure[1]) <= 2.0


def test_both_units_differ_in_the_rig_alone() -> None:
    """The one for several rigs is the other with %i for its rig, but for the lines that say so."""
    one, many = ((SYSTEMD / name).read_text().splitlines() for name in UNITS)
    assert len(one) == len(many)
    differing = [(a, b) for a, b in zip(one, many, strict=True) if a.replace("/rig.yaml", "/%i.yaml") != b]
    assert [a.split("=")[0] for a, _ in differing if not a.startswith("#")] == ["Description"]


@pytest.mark.parametrize("name", UNITS)
def test_stopping_the_heads_is_the_last_word(name: str) -> None:
    assert re.search(r"^ExecStopPost=.*camrig stop ", (SYSTEMD / name).read_text(), re.MULTILINE)


def test_the_service_is_installed_below_a_root_and_says_what_it_did(tmp_path: Path) -> None:
    arguments = ("--root", str(tmp_path), "--program", "/usr/lib/camrig/bin/camrig", "--json")
    planned = _install(*arguments, "--dry-run")
    assert planned.returncode == 0, planned.stderr
    assert not list(tmp_path.iterdir())
    done = _install(*arguments)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == json.loads(planned.stdout)["steps"]
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()} == INSTALLED
    unit = (tmp_path / "etc/systemd/system/camrig.service").read_text()
    assert "ExecStart=/usr/lib/camrig/bin/camrig run /etc/camrig/rig.yaml" in unit
    assert "/opt/" not in unit
    (tmp_path / "etc/sysusers.d/camrig.conf").write_text("something else")
    again = json.loads(_install(*arguments).stdout)["steps"]
    assert {step["state"] for step in again if "sysusers" not in step["what"]} == {"unchanged"}
    assert {step["state"] for step in again if "sysusers" in step["what"]} == {"updated"}


@pytest.mark.parametrize("program", ["/home/alice/.venv/bin/camrig", "/tmp/venv/bin/camrig"])
def test_a_program_that_the_service_cannot_see_is_refused(tmp_path: Path, program: str) -> None:
    found = _install("--root", str(tmp_path), "--program", program)
    assert found.returncode == 2
    assert "out of the service's sight" in found.stderr
    assert not list(tmp_path.iterdir())


def test_a_program_is_named_by_an_absolute_path(tmp_path: Path) -> None:
    found = _install("--root", str(tmp_path), "--program", "bin/camrig")
    assert found.returncode == 2
    assert "bin/camrig is a relative path" in found.stderr
    assert not list(tmp_path.iterdir())


def test_a_link_to_a_program_that_the_service_cannot_see_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, link = tmp_path / "home", tmp_path / "camrig"
    monkeypatch.setattr(service_files, "_HIDDEN", (str(home),))
    link.symlink_to(home / "camrig")
    with pytest.raises(InputError, match="out of the service's sight"):
        service_files.Service(tmp_path, link).plan()


def test_a_root_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("a file where a folder should be")
    found = _install("--root", str(tmp_path), "--program", "/usr/bin/camrig")
    assert found.returncode == 2
    assert "cannot be written" in found.stderr
    assert "Traceback" not in found.stderr
