"""camrig as a rig's host has it, in /opt/camrig of the guest, with kernels compiled for the emulated processor.

The tree lies in the cache and is brought up to date file by file, so that what did not change keeps its time stamp:
numba holds a compiled kernel for stale when its source is younger, and compiling takes a minute here, an hour there.
"""

from __future__ import annotations

import filecmp
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

from camrig.geometry.jit import KERNELS
from tests.kernels import COMPILE
from tests.vm.image import CACHE

SHARE = CACHE / "camrig"
"""Laid over the guest's root."""
DEPENDENCIES = Path(sysconfig.get_path("purelib"))
"""Of the environment that runs this: the guest sees them in /opt/camrig/dependencies."""
BASE = Path(sys.base_prefix)
"""Of its interpreter, in the guest /opt/camrig/base: it may lie in a home, which the service does not see."""
PROCESSOR = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
"""What kernels are compiled for, here and there: numba would refuse those made for the host's own processor."""

_REPOSITORY = Path(__file__).parents[2]
_PACKAGES = {
    "camrig": _REPOSITORY / "camrig",
    "camrig_drivers": _REPOSITORY / "drivers/camrig_drivers",
    "camrig_emulators": _REPOSITORY / "drivers/camrig_emulators",
}
_OPT = SHARE / "opt/camrig"
_SITE = _OPT / f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
_KERNELS = SHARE / "var/cache/camrig"
_SCRIPT = """\
#!/opt/camrig/bin/python
from camrig.cli.main import main

main()
"""


def deploy(*, kernels: bool) -> None:
    """Bring the guest's /opt/camrig up to date with this repository; ``kernels``: compiled too, for who runs camrig."""
    _lay_out()
    changed = [name for name, source in _PACKAGES.items() for name in _update(source, _SITE / name, name)]
    if any(name.startswith(tuple(f"camrig/{folder}/" for folder in KERNELS)) for name in changed):
        for kept in _SITE.rglob("__pycache__/*.nb?"):
            kept.unlink()
    if kernels:
        if not next(_SITE.rglob("__pycache__/*.nbc"), None):
            print("compiling the kernels for the VM: some minutes", flush=True)
        _run(COMPILE)
        _lay_out_kernels()
    _run("import compileall, sys; compileall.compile_dir(sys.path[0], quiet=2)")


def _lay_out() -> None:
    (_OPT / "bin").mkdir(parents=True, exist_ok=True)
    _SITE.mkdir(parents=True, exist_ok=True)
    python = _OPT / "bin/python"
    python.unlink(missing_ok=True)
    python.symlink_to(
        Path("/opt/camrig/base/bin", Path(getattr(sys, "_base_executable", sys.executable)).resolve().name)
    )
    (_OPT / "pyvenv.cfg").write_text("home = /opt/camrig/base/bin\ninclude-system-site-packages = false\n")
    shutil.copytree(_REPOSITORY / "systemd", _OPT / "share/camrig/systemd", dirs_exist_ok=True)
    (_SITE / "dependencies.pth").write_text("/opt/camrig/dependencies\n")
    (_OPT / "bin/camrig").write_text(_SCRIPT)
    (_OPT / "bin/camrig").chmod(0o755)


def _lay_out_kernels() -> None:
    """Have the kernels where the unit keeps them, in a folder for each folder of sources, named as numba names it."""
    shutil.rmtree(_KERNELS, ignore_errors=True)
    for folder in {path.parent for path in _SITE.rglob("__pycache__/*.nb?")}:
        source = Path("/") / folder.parent.relative_to(SHARE)
        kept = _KERNELS / f"{source.name}_{hashlib.sha1(str(source).encode()).hexdigest()}"
        kept.mkdir(parents=True)
        for path in folder.glob("*.nb?"):
            shutil.copy2(path, kept)


def _update(source: Path, copy: Path, name: str) -> Iterator[str]:
    """Make ``copy`` a copy of ``source`` and yield what had changed."""
    wanted = {path.relative_to(source) for path in _files(source)}
    for path in wanted:
        there = copy / path
        if not (there.is_file() and filecmp.cmp(source / path, there, shallow=False)):
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / path, there)
            yield f"{name}/{path}"
    for path in {path.relative_to(copy) for path in _files(copy)} - wanted:
        (copy / path).unlink()
        yield f"{name}/{path}"


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_file() and path.parent.name != "__pycache__")


def _run(program: str) -> None:
    path = os.pathsep.join((str(_SITE), str(DEPENDENCIES)))
    environment = {**os.environ, **PROCESSOR, "PYTHONPATH": path}
    subprocess.run([sys.executable, "-P", "-c", program], env=environment, check=True)
