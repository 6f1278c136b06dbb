"""``python -m tests.vm``: run the tests that need a kernel of their own in a VM; see docs/testing-in-a-vm.md.

Exit codes: 0 all passed, or skipped where this host cannot run the VM (the reason is printed); 124 time-out; 125 the
VM died; else pytest's own.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tests.vm import image
from tests.vm.deployment import deploy
from tests.vm.machine import Boot, run

REPOSITORY = Path(__file__).parents[2]
PYTEST = ("-m", "pytest", "-p", "no:cacheprovider", "-o", "timeout=900", "-v", "-s", "--durations=0")
CAMERAS = Boot(modules=("vivid n_devs=3 node_types=0x1,0x1,0x1 num_inputs=1,1,1 input_types=0,0,0",))
TESTS: Mapping[str, Sequence[str]] = {"cameras": ("test_vivid*.py",), "service": ("test_service*.py",)}
"""Of this folder. Those of cameras run in the guest; those of the service run here and have a guest of their own."""


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        image.prepare()
    except image.UnavailableError as reason:
        print(f"the VM's tests are skipped: {reason}")
        return 0
    deploy(kernels=options.command or options.tests != ["cameras"])  # of which those of cameras need none
    if options.command:
        boot = replace(CAMERAS, systemd=options.systemd)
        return run(boot, options.command, REPOSITORY, _environment(), options.timeout_s)
    status = 0
    for name in options.tests or TESTS:
        print(f"== the VM: {name}", flush=True)
        found = sorted(path for pattern in TESTS[name] for path in Path(__file__).parent.glob(pattern))
        pytest = (*PYTEST, "-m", _selection(slow=options.slow), *map(str, found))
        if name == "cameras":
            command = ("/opt/camrig/bin/python", "-P", *pytest)
            status = max(status, run(CAMERAS, command, REPOSITORY, _environment(), options.timeout_s))
        else:
            environment = {**os.environ, "CAMRIG_VM": "host"}
            command = (sys.executable, *pytest, "-x")  # each builds on those before it
            status = max(status, subprocess.run(command, cwd=REPOSITORY, env=environment, check=False).returncode)
    return status


def _selection(*, slow: bool) -> str:
    return "vm" if slow else "vm and not slow"


def _environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name == "CI" or name.startswith(("CAMRIG_", "LC_"))}
    return {
        "PATH": "/opt/camrig/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": "/root",
        **kept,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.vm", description="Run camrig's tests in a virtual machine.")
    parser.add_argument("tests", nargs="*", choices=[[], *TESTS], help="which tests; all where none is named")
    parser.add_argument("--slow", action="store_true", help="the tests marked slow too")
    parser.add_argument(
        "--timeout-s", type=float, default=300.0, help="of the cameras' tests or the command (%(default)s)"
    )
    parser.add_argument("--command", nargs=argparse.REMAINDER, help="run this in a guest instead of tests")
    parser.add_argument("--systemd", action="store_true", help="with --command: systemd as the guest's first program")
    return parser


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
