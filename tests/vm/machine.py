"""One boot of the VM: QEMU over the host's own files, a command inside, its output here, its exit status back."""

from __future__ import annotations

import re
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.vm import image
from tests.vm.deployment import BASE, DEPENDENCIES, PROCESSOR, SHARE

TIMED_OUT, DIED = 124, 125
_GUEST = Path(__file__).with_name("guest")
CONSOLE_CHARACTERS = 20_000
_KERNEL_ARGUMENTS = (
    *("console=ttyS0", "loglevel=4", "panic=-1"),
    # Under emulation these cost seconds, or go by a clock that the emulation does not keep.
    *("nokaslr", "mitigations=off", "no5lvl", "tsc=reliable", "random.trust_cpu=on", "cryptomgr.notests"),
    *("audit=0", "selinux=0", "apparmor=0", "fstab=no", "systemd.gpt_auto=no"),
)


@dataclass(frozen=True)
class Boot:
    """What one start of the guest is for; ``modules`` are lines for modprobe, ``devices`` arguments for QEMU."""

    systemd: bool = False
    modules: Sequence[str] = ()
    devices: Sequence[str] = ()
    memory_mb: int = 2048


class Machine:
    """A running guest, the folder ``share`` (/run/vm there), and ``shell`` to have commands obeyed in it.

    It is there from ``start`` or ``start_shell`` to ``stop``.
    """

    def __init__(self, boot: Boot, share: Path, folder: Path, environment: Mapping[str, str]) -> None:
        self.share = share
        self._boot = boot
        self._environment = {**environment, "VM_FOLDER": str(folder)}
        self._process: subprocess.Popen[bytes] | None = None
        self._shell: socket.socket | None = None

    def start(self, command: Sequence[str]) -> None:
        """Boot, and run a command once the guest is up; its output is ours."""
        self._fill(command)
        # A pipe as its input that nobody closes: at the end of its input QEMU would hang up the guest's output too.
        self._process = subprocess.Popen(self._qemu(), stdin=subprocess.PIPE)

    def start_shell(self, timeout_s: float) -> None:
        """Boot for ``shell``, and wait until it is there."""
        self.start(["sh", "/run/vm/shell"])
        self._shell = connected(self.share / "shell.sock", timeout_s)
        self._answer(timeout_s)

    def shell(self, command: str, timeout_s: float = 200.0) -> tuple[int, str]:
        """Have the guest's shell obey one line; return the exit status and what was said on both outputs."""
        if self._shell is None:
            raise RuntimeError("the machine was not started for a shell")
        self._shell.sendall(command.encode() + b"\n")
        return self._answer(timeout_s), (self.share / "answer").read_text(errors="replace")

    def wait(self, timeout_s: float) -> int:
        """Wait for the command; return its exit status, TIMED_OUT, or DIED with the guest."""
        if self._process is None:
            raise RuntimeError("the machine was not started")
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return TIMED_OUT
        status = self.share / "status"
        found = status.read_text().strip() if status.is_file() else ""
        return int(found) if found.isdigit() else DIED

    def waits_s(self) -> dict[str, float]:
        """Return for how long, so far, each of the guest's processors has waited for one of this machine's."""
        if self._process is None:
            raise RuntimeError("the machine was not started")
        threads = Path(f"/proc/{self._process.pid}/task").iterdir()
        return {thread.name: int((thread / "schedstat").read_text().split()[1]) * 1e-9 for thread in threads}

    def console(self) -> str:
        """Return what the kernel and the units said."""
        found = self.share / "console"
        return found.read_text(errors="replace") if found.is_file() else ""

    def stop(self) -> None:
        """Pull the plug; twice is allowed."""
        if self._shell is not None:
            self._shell.close()
            self._shell = None
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _answer(self, timeout_s: float) -> int:
        if self._shell is None:
            raise RuntimeError("the machine has stopped")
        self._shell.settimeout(timeout_s)
        received = b""
        while not received.endswith(b"\n"):
            data = self._shell.recv(64)
            if not data:
                raise RuntimeError("the VM died:\n" + self.console()[-CONSOLE_CHARACTERS:])
            received += data
        return int(received)

    def _fill(self, command: Sequence[str]) -> None:
        for script in _GUEST.iterdir():
            shutil.copy(script, self.share)
        known = {
            **self._environment,
            **PROCESSOR,
            "CAMRIG_VM": "guest",
            "VM_DEPENDENCIES": str(DEPENDENCIES),
            "VM_BASE": str(BASE),
        }
        lines = "".join(f"export {key}={shlex.quote(known[key])}\n" for key in known)
        (self.share / "environment").write_text(lines)
        (self.share / "modules").write_text("".join(f"{line}\n" for line in self._boot.modules))
        (self.share / "command").write_text(f"exec {shlex.join(command)}\n")

    def _qemu(self) -> list[str]:
        init = "systemd" if self._boot.systemd else "work"
        return [
            *("setpriv", "--pdeathsig", "KILL"),  # whatever ends us ends the guest
            *("qemu-system-x86_64", "-accel", _accelerator(), "-cpu", "max", "-smp", "2"),
            *("-m", str(self._boot.memory_mb), "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot"),
            *("-kernel", str(image.KERNEL), "-initrd", str(image.INITRD)),
            *("-append", " ".join((*_KERNEL_ARGUMENTS, f"vm.init={init}"))),
            *("-chardev", f"file,id=console,path={self.share}/console", "-serial", "chardev:console"),
            *("-device", "virtio-serial-pci", "-chardev", "stdio,id=output,signal=off"),
            *("-device", "virtserialport,chardev=output,name=output"),
            *port("shell", self.share / "shell.sock"),
            *_shared("host", Path("/"), ",readonly=on,multidevs=remap"),
            *_shared("layer", image.LAYER, ",readonly=on"),
            *_shared("camrig", SHARE, ",readonly=on"),
            *_shared("run", self.share, ""),
            *self._boot.devices,
        ]


def run(boot: Boot, command: Sequence[str], folder: Path, environment: Mapping[str, str], timeout_s: float) -> int:
    """Run a command in the guest, in ``folder``; return its exit status, TIMED_OUT, or DIED with the guest."""
    with tempfile.TemporaryDirectory(prefix="camrig-vm-") as share:
        machine = Machine(boot, Path(share), folder, environment)
        began_s = time.monotonic()
        try:
            machine.start(command)
            status = machine.wait(timeout_s)
        finally:
            machine.stop()
        console = machine.console()
        marks = ", ".join(re.findall(r"vm: (\w.* after [\d.]+ s)", console))
        print(f"the VM ran for {time.monotonic() - began_s:.0f} s ({marks})", file=sys.stderr)
        if status in (TIMED_OUT, DIED):
            print(console[-CONSOLE_CHARACTERS:], file=sys.stderr)
        return status


def port(name: str, path: Path) -> tuple[str, ...]:
    """Return QEMU's arguments for a fast serial line of the guest, under this name, that a socket here leads to."""
    device = f"virtserialport,chardev={name},name={name}"
    return ("-chardev", f"socket,id={name},path={path},server=on,wait=off", "-device", device)


def uart(name: str, path: Path) -> tuple[str, ...]:
    """Return QEMU's arguments for the guest's next serial port (ttyS1 is the first) that a socket here leads to."""
    return ("-chardev", f"socket,id={name},path={path},server=on,wait=off", "-serial", f"chardev:{name}")


def connected(path: Path, timeout_s: float) -> socket.socket:
    """Return a connection to one of those sockets, as soon as QEMU has made it."""
    channel = socket.socket(socket.AF_UNIX)
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            channel.connect(str(path))
        except OSError:
            if time.monotonic() > deadline_s:
                channel.close()
                raise
            time.sleep(0.05)
        else:
            return channel


def _shared(name: str, folder: Path, options: str) -> tuple[str, ...]:
    share = f"local,id={name},path={folder},security_model=none{options}"
    return ("-fsdev", share, "-device", f"virtio-9p-pci,fsdev={name},mount_tag={name}")


def _accelerator() -> str:
    """KVM only on a processor that does it: there is a KVM in software that is slower than QEMU's own emulation."""
    processor = Path("/proc/cpuinfo").read_text()
    try:
        with Path("/dev/kvm").open("r+b"):
            usable = re.search(r"^flags.*\b(vmx|svm)\b", processor, re.MULTILINE) is not None
    except OSError:
        usable = False
    return "kvm" if usable else "tcg,thread=multi,tb-size=512"
