"""The checks of a computer that is to run a rig. Each reads; none changes anything or needs a privilege."""

from __future__ import annotations

import grp
import os
import pwd
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from camrig.host.findings import Finding
from camrig.host.kernel_clock import KernelClock
from camrig.host.plugged_in import Device, PluggedIn
from camrig.messages import Verdict

GROUPS = {"video": "cameras", "dialout": "serial ports"}
"""Who may open what on Debian and its kin."""
_LOW_DISK_GB, _NO_DISK_GB = 5.0, 0.5
_SLOW_LATENCY_MS = 1
_PACKAGE = Path(__file__).parents[1]
_ROOT = 0


def check_devices(found: PluggedIn) -> Iterator[Finding]:
    """Judge what is plugged in: each device that cannot be used, and one word for those that can."""
    yield from _check_kind("cameras", found.cameras, "plug a camera in; an emulated rig needs none")
    yield from _check_kind("serial ports", found.ports, "plug the heads' adapter in; bolted cameras need none")


def _check_kind(kind: str, devices: Sequence[Device], cure: str) -> Iterator[Finding]:
    fit = [device.found.title for device in devices if not device.found.trouble]
    for device in devices:
        if device.found.trouble:
            what, _, todo = device.found.trouble.partition("; ")
            yield Finding(kind, Verdict.RED, f"{device.found.name}: {what}", todo)
    if fit:
        yield Finding(kind, Verdict.GREEN, f"{len(fit)} to use: {', '.join(fit)}")
    elif not devices:
        yield Finding(kind, Verdict.AMBER, "none is plugged in", cure)


def check_groups(user_id: int, group_ids: frozenset[int]) -> Iterator[Finding]:
    """Tell whether this user may open devices by the groups it is in."""
    if user_id == _ROOT:
        yield Finding("groups", Verdict.GREEN, "root may open every device; the service needs no root")
        return
    try:
        user = pwd.getpwuid(user_id).pw_name
    except KeyError:  # as in many a container
        user = f"user {user_id}"
    for name, devices in GROUPS.items():
        try:
            group = grp.getgrnam(name)
        except KeyError:
            continue  # another system's habit: what cannot be opened is found by opening it
        if group.gr_gid in group_ids:
            yield Finding("groups", Verdict.GREEN, f"{user} is in {name}: it may open {devices}")
        else:
            cure = f"sudo usermod -aG {name} {user}, then log in again"
            yield Finding("groups", Verdict.AMBER, f"{user} is not in {name}: {devices} may refuse it", cure)


def tried(about: str, check: Callable[[], Finding]) -> Finding:
    """Return what a check finds, or that the computer does not tell: containers keep a good deal to themselves."""
    try:
        return check()
    except OSError as error:
        cure = "run doctor in another folder, and outside of a container"
        return Finding(about, Verdict.AMBER, f"unknown: the kernel says {error.strerror or error}", cure)


def check_clock(clock: KernelClock) -> Finding:
    """Judge how well UTC is known; stamps inside a rig are monotonic and do not suffer."""
    if clock.synchronised:
        return Finding("clock", Verdict.GREEN, f"synchronised; off by {1e3 * clock.max_error_s:.0f} ms at most")
    cure = "start systemd-timesyncd or chrony; several hosts in one rig need it, one host alone only for its records"
    return Finding("clock", Verdict.AMBER, "not synchronised: UTC in outputs may be wrong by anything", cure)


def check_disk(folder: Path) -> Finding:
    """Judge the room for recordings where the program runs."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    says = f"{free_gb:.1f} GB free at {folder.resolve()}"
    if free_gb >= _LOW_DISK_GB:
        return Finding("disk", Verdict.GREEN, says)
    health = Verdict.AMBER if free_gb >= _NO_DISK_GB else Verdict.RED
    return Finding("disk", health, says, "make room: recordings and logs stop where it ends")


def check_kernels() -> Finding:
    """Tell whether the planner's compiled kernels are kept for this user."""
    folders = [_PACKAGE]
    with suppress(RuntimeError):  # a user without a home
        folders.append(Path(os.environ.get("NUMBA_CACHE_DIR") or Path.home() / ".cache/numba"))
    kept = sum(1 for folder in folders for _ in folder.rglob("*.nbi"))
    if kept:
        return Finding("kernels", Verdict.GREEN, f"{kept} compiled kernels of the planner are kept")
    cure = "run `camrig demo --headless --seconds 5` once as the user that will run the rig"
    return Finding("kernels", Verdict.AMBER, "not compiled yet: the first plan takes a minute longer", cure)


def check_latency(sys: Path = Path("/sys")) -> Iterator[Finding]:
    """Find USB serial adapters that hold answers back, which makes the stamps of heads late by as much."""
    for timer in sorted((sys / "bus/usb-serial/devices").glob("*/latency_timer")):
        with suppress(OSError, ValueError):
            latency_ms = int(timer.read_text())
            port = f"/dev/{timer.parent.name}"
            if latency_ms > _SLOW_LATENCY_MS:
                cure = f"echo {_SLOW_LATENCY_MS} | sudo tee {timer}, or a udev rule that does so"
                yield Finding("latency", Verdict.AMBER, f"{port} holds answers back for {latency_ms} ms", cure)
            else:
                yield Finding("latency", Verdict.GREEN, f"{port} holds answers back for {latency_ms} ms at most")


def this_user() -> tuple[int, frozenset[int]]:
    """Return the user of this process and its groups."""
    return os.geteuid(), frozenset((*os.getgroups(), os.getegid()))
