"""What an experiment ran on: its figures mean nothing without."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

_PACKAGES = ("camrig", "numpy", "scipy", "numba", "casadi")
_CPU_INFO = Path("/proc/cpuinfo")
THREADS = "OMP_NUM_THREADS"
"""What limits the threads of linear algebra: it is read when a program starts, so its caller sets it."""


def machine() -> dict[str, object]:
    """Return the processor's model, how many cores this process may use, and what limits its threads."""
    return {"cpu": _cpu(), "cores": len(os.sched_getaffinity(0)), "omp_num_threads": os.environ.get(THREADS)}


def versions() -> dict[str, str]:
    """Return the versions of what does the computing; what is not installed is left out."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def in_words(about: Mapping[str, object], of: Mapping[str, str]) -> str:
    """Return machine and versions as a sentence."""
    packages = ", ".join(f"{name} {version}" for name, version in of.items())
    threads = about["omp_num_threads"]
    limit = f"{THREADS}={threads}" if threads else f"{THREADS} not set"
    return f"{about['cpu']}, {about['cores']} cores, {limit}; {packages}."


def _cpu() -> str:
    for line in _CPU_INFO.read_text().splitlines() if _CPU_INFO.exists() else []:
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()
