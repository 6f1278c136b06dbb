"""The files that make camrig a service of systemd, and putting them into a system."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import camrig
from camrig.errors import HardwareError, InputError

_PROGRAM_IN_UNITS = "/opt/camrig/bin/camrig"
_PLACES = {
    "camrig.service": "etc/systemd/system/camrig.service",
    "camrig@.service": "etc/systemd/system/camrig@.service",
    "sysusers.d/camrig.conf": "etc/sysusers.d/camrig.conf",
    "udev/60-camrig.rules": "etc/udev/rules.d/60-camrig.rules",
}
_CONFIGURATIONS = "etc/camrig"
_COMMANDS = (
    ("systemd-sysusers", "/etc/sysusers.d/camrig.conf"),
    ("systemctl", "daemon-reload"),
    ("udevadm", "control", "--reload"),
    # Devices that are plugged in already.
    ("udevadm", "trigger", "--action=add", "--subsystem-match=usb-serial"),
    ("udevadm", "trigger", "--action=add", "--subsystem-match=tty", "--subsystem-match=video4linux"),
)
_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")
"""What ProtectHome and PrivateTmp keep from the service."""


@dataclass(frozen=True)
class Step:
    """One thing done or to do; ``state`` is written, updated, unchanged, made or run."""

    what: str
    state: str


def default_program() -> Path:
    """Return the camrig program of the environment that runs now."""
    return Path(sys.executable).with_name("camrig")


def folder() -> Path:
    """Return where the files are: in a checkout its own, else what was installed with the package."""
    checkout = Path(camrig.__file__).parents[1] / "systemd"
    return checkout if checkout.is_dir() else Path(sysconfig.get_path("data")) / "share/camrig/systemd"


@dataclass(frozen=True)
class Service:
    """camrig as a service of the system under ``root``; ``program`` is what it starts."""

    root: Path
    program: Path

    def plan(self) -> Sequence[Step]:
        """Return what ``install`` would do; raises InputError where the service could not start the program."""
        self._check_program()
        places = {self._place(place): text for place, text in self._texts().items()}
        steps = [Step(str(path), _state(path, text)) for path, text in places.items()]
        configurations = self._place(_CONFIGURATIONS)
        steps.append(Step(str(configurations), "unchanged" if configurations.is_dir() else "made"))
        return [*steps, *(Step(" ".join(command), "run") for command in self._commands())]

    def install(self) -> Sequence[Step]:
        """Put everything in place; raises InputError where a file cannot be written, HardwareError where systemd
        refuses. Twice is allowed.
        """
        steps = self.plan()
        try:
            for place, text in self._texts().items():
                _write(self._place(place), text)
            self._place(_CONFIGURATIONS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{error.filename} cannot be written: {error.strerror}; it takes root (sudo), or --root DIR"
            ) from error
        for command in self._commands():
            _run(command)
        return steps

    def _place(self, place: str) -> Path:
        return self.root / place

    def _commands(self) -> Sequence[tuple[str, ...]]:
        return _COMMANDS if self.root == Path("/") else ()

    def _texts(self) -> dict[str, str]:
        source = folder()
        try:
            return {
                place: (source / name).read_text().replace(_PROGRAM_IN_UNITS, str(self.program))
                for name, place in _PLACES.items()
            }
        except OSError as error:
            raise InputError(f"{error.filename} is missing: {error.strerror}; install camrig again with pip") from error

    def _check_program(self) -> None:
        """Refuse a program that the service will not find, or that anybody may replace."""
        if not self.program.is_absolute():
            raise InputError(f"{self.program} is a relative path: name the service's camrig by an absolute one")
        for hidden in _HIDDEN:
            if self.program.is_relative_to(hidden) or self.program.resolve().is_relative_to(hidden):
                raise InputError(
                    f"{self.program} is out of the service's sight, which sees nothing below {hidden}: "
                    f"install camrig in /opt/camrig, or name another with --program"
                )
        if self.root == Path("/") and not os.access(self.program, os.X_OK):
            raise InputError(f"{self.program} is no program: name the service's camrig with --program")


def _state(path: Path, text: str) -> str:
    if not path.is_file():
        return "written"
    return "unchanged" if path.read_text(errors="replace") == text else "updated"


def _write(path: Path, text: str) -> None:
    if _state(path, text) != "unchanged":
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(0o644)


def _run(command: Sequence[str]) -> None:
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = (getattr(error, "stderr", None) or str(error)).strip()
        raise HardwareError(f"`{' '.join(command)}` failed: {said}; the files are in place") from error
