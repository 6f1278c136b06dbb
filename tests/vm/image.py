"""The guest's kernel and tools: Debian's packages, fetched once and unpacked into a cache; nothing is installed.

What the host lacks lies in ``LAYER``, which the guest lays over the host's own files. The one module that Debian has
as source only (v4l2loopback) is built against the kernel's headers.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import platform
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "camrig-vm"
LAYER = CACHE / "layer"
KERNEL = CACHE / "vmlinux"
INITRD = CACHE / "initrd.gz"

_TOOLS = (
    *("busybox-static", "kmod", "libkmod2", "udev", "libudev1"),
    *("systemd", "libsystemd-shared", "libsystemd0"),
    *("v4l-utils", "libv4l-0", "libv4lconvert0", "libv4l2rds0"),
)
_NEEDED = {
    "qemu-system-x86_64": "qemu-system-x86 ipxe-qemu",
    "systemctl": "systemd",
    "dpkg-deb": "dpkg",
    "gcc": "gcc",
    "make": "make",
}
"""Programs of the host, and the packages that have them."""
_BOOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_console")
_GUEST_INIT = Path(__file__).with_name("guest") / "init"
_UNWANTED = ("./usr/share/doc", "./usr/share/man", "./usr/share/locale")
_MERGED_USR = r"flags=r;s,^\./\(lib\|bin\|sbin\)\(/\|$\),./usr/\1\2,"
"""So that no folder of a package takes the place of the host's links /lib, /bin and /sbin."""


class UnavailableError(Exception):
    """This host cannot run the VM; says what is missing."""


def prepare() -> None:
    """Fill the cache unless it is full; raises UnavailableError where the host lacks what it takes."""
    if platform.machine() != "x86_64":
        raise UnavailableError("the VM is an x86_64 machine running the host's own programs, and this host is not one")
    for program, package in _NEEDED.items():
        if shutil.which(program) is None:
            raise UnavailableError(f"{program} is not installed (apt-get install --no-install-recommends {package})")
    recipe = hashlib.sha256(Path(__file__).read_bytes() + _GUEST_INIT.read_bytes()).hexdigest()
    done = CACHE / "recipe"
    if done.is_file() and done.read_text() == recipe:
        return
    print(f"preparing the VM in {CACHE}", flush=True)
    done.unlink(missing_ok=True)
    _build()
    done.write_text(recipe)


def _build() -> None:
    image = _dependency("linux-image-amd64", "linux-image-")
    version = image.removeprefix("linux-image-")
    shutil.rmtree(LAYER, ignore_errors=True)
    (LAYER / "usr").mkdir(parents=True)
    for package in _fetch(image, *_TOOLS):
        _unpack(package, LAYER)
    _extract_kernel(LAYER / "boot" / f"vmlinuz-{version}", KERNEL)
    _build_loopback(version)
    _index_modules(version)
    _build_initrd(version)


def _dependency(package: str, prefix: str) -> str:
    """Return the package that a meta-package stands for."""
    said = _apt("apt-cache", "depends", package)
    found = re.search(rf"Depends: ({prefix}\S+)", said)
    if found is None:
        raise UnavailableError(f"apt knows no package {package}: the VM runs Debian's own kernel")
    return found[1]


def _fetch(*packages: str) -> list[Path]:
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        _apt("apt-get", "-q", "download", *packages, folder=folder)
        kept = CACHE / "packages"
        kept.mkdir(exist_ok=True)
        return [Path(shutil.move(found, kept / found.name)) for found in sorted(Path(folder).glob("*.deb"))]


def _apt(*command: str, folder: str | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", "").strip().splitlines()
        raise UnavailableError(f"`{' '.join(command)}` failed: {said[-1] if said else error}") from error
    return done.stdout


def _unpack(package: Path, folder: Path) -> None:
    tar = ["tar", "-x", "-C", str(folder), "--no-same-owner", "--keep-directory-symlink", "--transform", _MERGED_USR]
    with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", package], stdout=subprocess.PIPE) as archive:
        subprocess.run([*tar, *(f"--exclude={name}" for name in _UNWANTED)], stdin=archive.stdout, check=True)


def _extract_kernel(compressed: Path, kernel: Path) -> None:
    """Unpack the kernel here: the guest, which is emulated, would need long for it."""
    data = compressed.read_bytes()
    for start in (found.start() for found in re.finditer(rb"\xfd7zXZ\0", data)):
        try:
            unpacked = lzma.LZMADecompressor().decompress(data[start:])
        except lzma.LZMAError:
            continue
        if unpacked.startswith(b"\x7fELF"):
            kernel.write_bytes(unpacked)
            return
    raise UnavailableError(f"{compressed.name} holds no kernel packed with xz")


def _build_loopback(version: str) -> None:
    flavour, common = f"linux-headers-{version}", f"linux-headers-{version.removesuffix('-amd64')}-common"
    kbuild = _dependency(flavour, "linux-kbuild-")
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        root = Path(folder)
        (root / "usr").mkdir()
        for package in _fetch(flavour, common, kbuild, "v4l2loopback-dkms"):
            _unpack(package, root)
        headers = root / "usr/src" / flavour
        for makefile in (headers / "Makefile", headers / ".kernelvariables"):
            if makefile.is_file():
                makefile.write_text(makefile.read_text().replace("/usr/src/", f"{root}/usr/src/"))
        (source,) = (root / "usr/src").glob("v4l2loopback-*")
        command = ["make", "-s", "-C", str(headers), f"M={source}", "modules"]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode != 0:
            raise UnavailableError(f"v4l2loopback does not build: {(built.stderr or built.stdout).strip()[-500:]}")
        extra = _modules(version) / "extra"
        extra.mkdir()
        shutil.copy(source / "v4l2loopback.ko", extra)


def _modules(version: str) -> Path:
    return LAYER / "usr/lib/modules" / version


def _index_modules(version: str) -> None:
    libraries = {**os.environ, "LD_LIBRARY_PATH": str(LAYER / "usr/lib/x86_64-linux-gnu")}
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:  # depmod wants lib/modules
        (Path(folder) / "lib").symlink_to(LAYER / "usr/lib")
        kmod = LAYER / "usr/bin/kmod"
        subprocess.run(["depmod", "-b", folder, version], executable=kmod, env=libraries, check=True)


def _build_initrd(version: str) -> None:
    busybox = LAYER / "usr/bin/busybox"
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        root = Path(folder)
        for name in ("bin", "modules", "proc", "sys", "dev", "host", "layer", "camrig", "rw", "root"):
            (root / name).mkdir()
        shutil.copy(busybox, root / "bin")
        (root / "bin/sh").symlink_to("busybox")
        shutil.copy(_GUEST_INIT, root / "init")
        (root / "init").chmod(0o755)
        order = _load_order(version)
        (root / "modules/order").write_text("\n".join(path.name for path in order) + "\n")
        for path in order:
            shutil.copy(path, root / "modules")
        pack = f"find . | {busybox} cpio -o -H newc 2>/dev/null | gzip -1 >{INITRD}"
        subprocess.run(["sh", "-c", pack], cwd=root, check=True)


def _load_order(version: str) -> list[Path]:
    """Return the modules that the initial system needs, each after those it depends on."""
    folder = _modules(version)
    lines = (line.partition(":") for line in (folder / "modules.dep").read_text().splitlines())
    depends = {path: needs.split() for path, _, needs in lines}
    by_name = {Path(path).stem.replace("-", "_"): path for path in depends}
    order: dict[str, None] = {}
    for name in _BOOT_MODULES:
        for path in (*reversed(depends[by_name[name]]), by_name[name]):
            order.setdefault(path)
    return [folder / path for path in order]
