"""What a computer is told of itself: each finding has a cure, and the first rig's file is one that `check` accepts."""

from __future__ import annotations

import ctypes
import grp
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from camrig.config.rig_file import load_rig
from camrig.host import checks
from camrig.host.checks import check_clock, check_devices, check_disk, check_groups, check_kernels, check_latency, tried
from camrig.host.detection import check_detection
from camrig.host.findings import Finding, worst
from camrig.host.first_rig import first_rig
from camrig.host.kernel_clock import KernelClock, ask_kernel_clock
from camrig.host.plugged_in import Device, PluggedIn
from camrig.interfaces import Found
from camrig.messages import Verdict

NOBODY = 65534


NAMELESS = 4_294_967_000
"""A user of no line in passwd, as containers have."""


def camera(number: int, trouble: str = "", size_px: tuple[int, int] | None = (640, 480)) -> Device:
    name = f"/dev/v4l/by-id/usb-Maker_Camera_{number}"
    section = {"device": name, "format": "YUYV", "fps": 30.0}
    return Device(("v4l2",), Found(name, f"Camera {number}", section, size_px, trouble=trouble))


def port(number: int) -> Device:
    name = f"/dev/serial/by-id/usb-FTDI_{number}"
    return Device(("pelco_d",), Found(name, "FTDI", {"port": name, "baud": 9600, "address": 1}))


@pytest.mark.parametrize(("cameras", "ports"), [(0, 0), (0, 2), (1, 0), (1, 1), (3, 1), (2, 5)])
def test_the_first_rig_is_one_that_check_accepts(tmp_path: Path, cameras: int, ports: int) -> None:
    found = PluggedIn(tuple(map(camera, range(cameras))), tuple(map(port, range(ports))))
    file = tmp_path / "rig.yaml"
    file.write_text(first_rig(found, "lab"))
    rig = load_rig(file).rig
    assert rig.name == "lab"
    assert len(rig.cameras) == max(1, cameras)
    assert len(rig.heads) == min(ports, max(1, cameras))
    assert not any(head.auto_enable for head in rig.heads.values())


def test_the_first_rig_keeps_to_the_pictures_that_were_found_and_names_what_it_leaves_out(tmp_path: Path) -> None:
    left_out = camera(9, "it offers no format that camrig reads", size_px=None)
    text = first_rig(PluggedIn((camera(0), camera(1, size_px=(1280, 720)), left_out), ()), "lab")
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    rig = load_rig(file).rig
    assert [camera.lens.size_px for camera in rig.cameras.values()] == [(640, 480), (1280, 720)]
    assert "#   /dev/v4l/by-id/usb-Maker_Camera_9: it offers no format that camrig reads" in text
    assert max(map(len, text.splitlines())) <= 120


def test_a_name_cannot_break_out_of_its_comment(tmp_path: Path) -> None:
    odd = Device(("v4l2",), Found('/dev/v4l/by-id/"odd"', "odd\nrig: other", {"device": 'a "b"'}, (64, 48)))
    file = tmp_path / "rig.yaml"
    file.write_text(first_rig(PluggedIn((odd,), ()), "lab"))
    assert load_rig(file).rig.name == "lab"


def test_devices_in_trouble_are_red_with_their_cure() -> None:
    busy = camera(1, "it is in use by cheese (pid 7); stop that first")
    findings = list(check_devices(PluggedIn((camera(0), busy), ())))
    assert findings == [
        Finding("cameras", Verdict.RED, f"{busy.found.name}: it is in use by cheese (pid 7)", cure="stop that first"),
        Finding("cameras", Verdict.GREEN, "1 to use: Camera 0"),
        Finding(
            "serial ports", Verdict.AMBER, "none is plugged in", "plug the heads' adapter in; bolted cameras need none"
        ),
    ]


def test_groups_name_the_command_that_joins_them() -> None:
    video, dialout = (grp.getgrnam(name).gr_gid for name in ("video", "dialout"))
    assert [finding.health for finding in check_groups(NOBODY, frozenset({video, dialout}))] == [Verdict.GREEN] * 2
    (_, missing) = check_groups(NOBODY, frozenset({video}))
    assert missing.health is Verdict.AMBER
    assert missing.cure == "sudo usermod -aG dialout nobody, then log in again"
    assert [finding.health for finding in check_groups(0, frozenset())] == [Verdict.GREEN]


def test_a_clock_that_nothing_holds_is_amber() -> None:
    good = check_clock(KernelClock(synchronised=True, max_error_s=0.0123))
    assert (good.health, good.says) == (Verdict.GREEN, "synchronised; off by 12 ms at most")
    assert check_clock(KernelClock(synchronised=False, max_error_s=16.0)).health is Verdict.AMBER


def test_the_kernel_tells_of_its_clock() -> None:
    assert ask_kernel_clock().max_error_s >= 0.0


@pytest.mark.skipif(sys.maxsize < 2**32, reason="the size is that of 64-bit Linux")
def test_the_kernel_finds_the_structure_that_it_writes_into() -> None:
    from camrig.host.kernel_clock import _Timex

    assert ctypes.sizeof(_Timex) == 208


@pytest.mark.parametrize(("free_gb", "health"), [(5.1, Verdict.GREEN), (4.9, Verdict.AMBER), (0.4, Verdict.RED)])
def test_a_full_disk_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free_gb: float, health: Verdict) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage(0, 0, int(free_gb * 1e9)))
    assert check_disk(tmp_path).health is health


def test_kernels_are_found_where_they_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(checks, "_PACKAGE", tmp_path / "package")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert check_kernels().health is Verdict.AMBER
    (tmp_path / "cache/optimise").mkdir(parents=True)
    (tmp_path / "cache/optimise/kernel.nbi").touch()
    assert check_kernels() == Finding("kernels", Verdict.GREEN, "1 compiled kernels of the planner are kept")


def test_adapters_that_hold_answers_back_are_found(tmp_path: Path) -> None:
    for name, latency in (("ttyUSB0", "16\n"), ("ttyUSB1", "1\n"), ("ttyUSB2", "?\n")):
        folder = tmp_path / "bus/usb-serial/devices" / name
        folder.mkdir(parents=True)
        (folder / "latency_timer").write_text(latency)
    slow, fast = check_latency(tmp_path)
    assert (slow.health, slow.says) == (Verdict.AMBER, "/dev/ttyUSB0 holds answers back for 16 ms")
    assert fast.health is Verdict.GREEN


def test_detection_is_timed() -> None:
    found = check_detection(cores=2)
    assert "pictures of 1280x720 a second a core, 2 cores: pyapriltags on a busy picture" in found.says
    assert bool(found.cure) == (found.health is not Verdict.GREEN)


def test_the_worst_finding_is_how_it_is() -> None:
    green, amber, red = (Finding("x", health, "") for health in Verdict)
    assert worst([]) is worst([green]) is Verdict.GREEN
    assert worst([green, amber]) is Verdict.AMBER
    assert worst([amber, red, green]) is Verdict.RED


def test_a_user_without_a_name_or_a_home_is_judged_too(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "user 4294967000 is not in video" in next(iter(check_groups(NAMELESS, frozenset()))).says
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "home", _homeless)
    assert check_kernels().about == "kernels"


def _homeless() -> Path:
    raise RuntimeError("Could not determine home directory.")


def test_what_the_kernel_does_not_tell_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    finding = tried("disk", lambda: check_disk(Path.cwd()))
    assert (finding.about, finding.health) == ("disk", Verdict.AMBER)
    assert "No such file or directory" in finding.says
