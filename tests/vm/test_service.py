"""camrig as a service of a real systemd, its camera a real V4L2 device, its head on a real UART.

The guest is the rig's host; this process is the room around it: the head at the far end of the wire, whose every
command is logged with its time, and the pictures that the camera sees, rendered from where the head truly points. The
guest is emulated, twenty times slower than a machine and more: what takes long there is given long (``SCALE``).
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from camrig.config.rig_file import load_rig
from camrig.runtime.emulated import emulated_world
from tests.vm.bench import bench
from tests.vm.host import Host
from tests.vm.machine import Boot, Machine, port, uart

SCALE = 60.0
BOOT_S = 200.0
START_S = 5.0 * SCALE
"""The bar at native speed is READY within 5 s, which tests/system holds it to."""
STOP_ON_THE_WIRE_S = 0.5
KILLS = 5
"""By the slow tests too."""
NEAR_M = 0.05
SURE_SIGMAS = 4.0
PUBLISHED = 5

RIG = """\
rig: service
space: {{floor_m: [[0, 0], [4, 3]]}}
lenses:
  lab: {{size_px: [480, 360], fx: 800, fy: 800, cx: 240, cy: 180}}
cameras:
  - {{id: west, lens: lab, source: {source}, mount: {{head: pt1}}}}
heads:
  - {{id: pt1, driver: pelco_d, {port} address: 1, enable: auto, position_m: [0.5, 0.5, 2.2], rpy_deg: [0, 0, 45],
     pan_deg: [-90, 90], tilt_deg: [-90, 0], speed_deg_s: 30}}
targets:
  - {{id: {target}, motion: floor, tags: [{{id: 1, size_m: 0.25, T_body_tag: {{position_m: [0, 0, 0.2]}}}}]}}
{rest}
"""
ROOM = RIG.format(
    source="{driver: rendered, fps: 3}",
    port="",
    target="robot1",
    rest="world: {driver: emulated, seed: 1, robot_speed_m_s: [0.13, 0.15]}",
)
OWN_SECTIONS = """\
outputs: [{driver: jsonl, path: /var/lib/camrig/targets.jsonl}]
planner: {period_s: 3.0, gain: 0.0}
detector: {driver: pyapriltags, decimate: 2.0}
"""
OVERRIDES = """\
[Service]
Environment=NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES= LD_LIBRARY_PATH=/opt/camrig/base/lib
TimeoutStartSec=300
TimeoutStopSec=120
WatchdogSec=30
"""
PROBE = """\
[Service]
Type=oneshot
Environment=LD_LIBRARY_PATH=/opt/camrig/base/lib
ExecStart=/opt/camrig/bin/python /run/vm/probe.py /dev/video40 /dev/ttyS1 /dev/foreign /dev/hpet
StandardOutput=file:/run/vm/probed
"""
WITHOUT_STOP_POST = OVERRIDES + "ExecStopPost=\n"
"""So that what stops the heads is the guardian alone."""


def in_the_rig(target: str = "robot1", speed: str = "") -> str:
    """Return the rig's file of the guest."""
    return RIG.format(
        source="{driver: v4l2, device: /dev/video40, format: GREY}",
        port=f"port: /dev/ttyS1, {speed}",
        target=target,
        rest=OWN_SECTIONS,
    )


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with ExitStack() as stack:
        share = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="camrig-vm-")))
        share.chmod(0o755)  # camrig reads it too, in the guest
        (share / "room.yaml").write_text(ROOM)
        room, world = stack.enter_context(emulated_world(load_rig(share / "room.yaml")))
        assert world is not None
        ports = {"pt1": room.devices["heads"]["pt1"].raw["port"], "west": room.devices["cameras"]["west"].raw["url"]}
        boot = Boot(
            systemd=True,
            modules=("v4l2loopback video_nr=40 card_label=west max_buffers=6", "xhci_pci", "ftdi_sio"),
            devices=(
                *uart("head", share / "head.sock"),
                *port("camera", share / "camera.sock"),
                *("-device", "qemu-xhci", "-chardev", "null,id=ftdi"),
                *("-device", "usb-serial,chardev=ftdi,always-plugged=on,serial=A10KZP45"),
            ),
        )
        machine = Machine(boot, share, Path("/"), {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"})
        stack.callback(machine.stop)
        began_s = time.monotonic()
        machine.start_shell(BOOT_S)
        print(f"booted in {time.monotonic() - began_s:.0f} s")
        wire = stack.enter_context(bench(share, ports, room.rig.cameras["west"], BOOT_S))
        found = Host(machine, wire, world)
        found.sh("python3 /run/vm/feeder.py camera /dev/video40 480 360 >/run/vm/feeder 2>&1 &")
        yield found


def test_the_service_is_installed_by_its_own_command(host: Host) -> None:
    said = host.sh("/opt/camrig/bin/camrig install-service")
    assert "written   /etc/systemd/system/camrig.service" in said
    assert "run       systemctl daemon-reload" in said
    assert "uid=" in host.sh("id camrig")
    assert {"video", "dialout"} <= set(host.sh("id -nG camrig").split())
    assert "unprivileged" not in said


def test_the_udev_rules_name_an_adapter_and_make_it_prompt(host: Host) -> None:
    host.until(lambda: host.machine.shell("test -e /dev/camrig/serial-A10KZP45")[0] == 0, SCALE)
    assert host.sh("cat /sys/bus/usb-serial/devices/ttyUSB0/latency_timer").strip() == "1"
    assert host.sh("readlink -f /dev/camrig/serial-A10KZP45").strip() == "/dev/ttyUSB0"


def test_it_starts_and_tracks_from_a_v4l2_device(host: Host) -> None:
    host.write("/etc/camrig/rig.yaml", in_the_rig())
    host.write("/etc/systemd/system/camrig.service.d/vm.conf", WITHOUT_STOP_POST)
    began_s = time.monotonic()
    host.sh("systemctl daemon-reload && systemctl start camrig", START_S)
    host.measured("start", time.monotonic() - began_s)
    host.measured("tracking", host.until(host.tracks, 5.0 * SCALE))
    _is_where_it_is_said_to_be(host, began_s)


def _is_where_it_is_said_to_be(host: Host, since_s: float) -> None:
    """What is published as tracked is near the truth, or said to be as unsure as it is wrong."""
    host.until(lambda: host.errors_m(since_s)[0].size >= PUBLISHED, SCALE)
    errors_m, sigmas_m = host.errors_m(since_s)
    host.measured("error_m", float(np.median(errors_m)))
    host.measured("worst_error_m", float(errors_m.max()))
    assert np.median(errors_m) < NEAR_M
    assert (errors_m < np.maximum(NEAR_M, SURE_SIGMAS * sigmas_m)).all(), np.column_stack([errors_m, sigmas_m])


def test_its_journal_can_be_asked_by_device(host: Host) -> None:
    said = host.sh(
        "journalctl -u camrig CAMRIG_DEVICE=pt1 CAMRIG_STATE=up -o json --output-fields=MESSAGE,PRIORITY -n 1"
    )
    entry = json.loads(said)
    assert entry["MESSAGE"] == "pt1: link up"
    assert entry["PRIORITY"] == "6"
    assert "CAMRIG_TARGET" not in entry


def test_it_is_nobody_and_may_do_nothing_else(host: Host) -> None:
    """A program in camrig's place, in the very unit: what it tries beyond cameras, lines and sockets is refused."""
    keep = "^ExecStart=|^ExecStopPost|^ExecReload|^Type|^Restart|^Watchdog"
    host.sh(f"grep -Ev '{keep}' /etc/systemd/system/camrig.service >/run/systemd/system/probe.service")
    host.sh("mknod -m 666 /dev/foreign c 1 2 && chmod 666 /dev/hpet /dev/ttyUSB0")  # c 1 2 is the whole memory
    host.write("/run/systemd/system/probe.service.d/probe.conf", PROBE)
    host.sh("systemctl daemon-reload && systemctl start probe")
    found = json.loads((host.machine.share / "probed").read_text())
    assert found.pop("uid") == host.sh("id -u camrig").strip() != "0"
    assert host.sh("ps -o user= -p $(systemctl show camrig -P MainPID)").strip() == "camrig"
    allowed = {name for name, came_of_it in found.items() if came_of_it == "allowed"}
    assert allowed == {"/dev/video40", "/dev/ttyS1", "/var/lib/camrig/probe", "AF_UNIX", "AF_INET", "AF_INET6", "nice"}
    assert {found[name] for name in ("AF_NETLINK", "AF_PACKET", "AF_VSOCK")} == {"EAFNOSUPPORT"}
    assert {found[name] for name in ("/dev/foreign", "/dev/hpet")} == {"EPERM"}
    assert {found[name] for name in ("/etc/probe", "/usr/probe", "/var/lib/probe")} == {"EROFS"}


def test_a_reload_of_a_faulty_file_changes_nothing(host: Host) -> None:
    pid = host.show("MainPID")
    host.write("/etc/camrig/rig.yaml", in_the_rig(target="robot2").replace("speed_deg_s: 30", "speed_deg_s: fast"))
    host.sh("systemctl reload camrig")
    host.until(lambda: "reload refused" in host.show("StatusText"), SCALE)
    assert "speed_deg_s" in host.show("StatusText")
    assert "speed_deg_s" in host.sh("journalctl -u camrig PRIORITY=3 -n 1")
    assert (host.show("MainPID"), host.show("ActiveState")) == (pid, "active")
    host.write("/etc/camrig/rig.yaml", in_the_rig())


@pytest.mark.slow
def test_a_reload_of_a_good_file_stops_the_head_and_tracks_by_the_new_one(host: Host) -> None:
    pid, since_s = host.show("MainPID"), time.monotonic()
    host.write("/etc/camrig/rig.yaml", in_the_rig(target="robot2"))
    host.sh("systemctl reload camrig")
    published = "tail -n 1 /var/lib/camrig/targets.jsonl"
    host.measured("reload", host.until(lambda: "robot2" in host.sh(published), 5.0 * SCALE))
    host.until(host.tracks, 5.0 * SCALE)
    assert host.wire.stops(since_s)
    assert host.show("MainPID") == pid, host.sh("journalctl -u camrig -n 60 -o short-monotonic")
    assert "refused" not in host.show("StatusText")
    host.write("/etc/camrig/rig.yaml", in_the_rig())


def test_killed_it_leaves_a_stopped_head(host: Host) -> None:
    _killed(host, 1)
    assert host.show("NRestarts") == "1"


def _killed(host: Host, number: int) -> None:
    """Kill it and hold the stop to its bar, less the time for which this machine had no processor for the guest."""
    pid = host.show("MainPID")
    killed_s, before_s = time.monotonic(), host.machine.waits_s()
    host.sh(f"kill -9 {pid}")
    host.until(lambda: bool(host.wire.stops(killed_s)), SCALE, every_s=0.01)
    after_s = host.machine.waits_s()
    took_s = host.wire.stops(killed_s)[0] - killed_s
    waited_s = max(after_s[thread] - before_s[thread] for thread in before_s.keys() & after_s.keys())
    host.measured(f"stop on the wire after SIGKILL {number}", took_s)
    host.measured("of that without a processor", waited_s)
    assert took_s - waited_s <= STOP_ON_THE_WIRE_S
    host.until(lambda: host.show("MainPID") not in (pid, "0"), SCALE)


@pytest.mark.slow
def test_killed_again_and_again_it_comes_back_and_tracks(host: Host) -> None:
    for number in range(2, KILLS + 1):
        _comes_back(host, "0", f"tracking after SIGKILL {number - 1}")
        _killed(host, number)
    _comes_back(host, "0", f"tracking after SIGKILL {KILLS}", moves=True)


def _comes_back(host: Host, pid: str, what: str, *, moves: bool = False) -> None:
    since_s = time.monotonic()
    host.until(lambda: host.is_active(pid), 2.0 * START_S)
    host.until(host.tracks, START_S)
    host.measured(what, time.monotonic() - since_s)
    if moves:
        host.until(lambda: bool(host.wire.motions(since_s)), 2.0 * START_S)  # the planner takes longest to start
        host.until(host.tracks, START_S)
        _is_where_it_is_said_to_be(host, since_s)


def test_hung_it_is_restarted_by_the_watchdog(host: Host) -> None:
    host.until(lambda: host.is_active("0"), 2.0 * START_S)
    host.write("/etc/systemd/system/camrig.service.d/vm.conf", OVERRIDES)
    host.sh("systemctl daemon-reload")
    pid = host.show("MainPID")
    hung_s = time.monotonic()
    host.sh(f"kill -STOP {pid}")
    host.measured("stop on the wire after SIGSTOP", host.until(lambda: bool(host.wire.stops(hung_s)), 3.0 * SCALE))
    host.until(lambda: host.show("MainPID") not in (pid, "0"), 3.0 * SCALE)
    assert "Watchdog timeout" in host.sh("journalctl -u camrig -n 200")


@pytest.mark.slow
def test_hung_it_comes_back_and_tracks(host: Host) -> None:
    _comes_back(host, "0", "tracking after SIGSTOP", moves=True)


def test_stopped_it_leaves_a_stopped_head(host: Host) -> None:
    since_s = time.monotonic()
    host.sh("systemctl stop camrig")
    assert host.show("ActiveState") == "inactive"
    time.sleep(1.0)
    assert host.wire.stops(since_s)[-1] > max(host.wire.motions(0.0), default=0.0)
