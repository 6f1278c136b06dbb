"""``camrig doctor``: how fit this computer is to run a rig."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from camrig.cli.console import COLOURS, people, print_json, results
from camrig.errors import HardwareError
from camrig.host.checks import (
    check_clock,
    check_devices,
    check_disk,
    check_groups,
    check_kernels,
    check_latency,
    this_user,
    tried,
)
from camrig.host.detection import check_detection
from camrig.host.findings import Finding, worst
from camrig.host.kernel_clock import ask_kernel_clock
from camrig.host.plugged_in import plugged_in
from camrig.messages import Verdict


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check permissions, clock, speed, disk and what is plugged in, each with its cure; exit 3 where one is red.

    Reads only: nothing is changed and nothing moves.
    """
    with people.status("looking at this computer"):
        findings = list(_findings())
    health = worst(findings)
    if as_json:
        print_json({"health": health.value, "findings": [_told(finding) for finding in findings]})
    else:
        results.print(_table(findings))
    if health is Verdict.RED:
        red = sum(finding.health is Verdict.RED for finding in findings)
        raise HardwareError(
            f"this computer is not fit yet: {red} of {len(findings)} findings are red; cure those first"
        )


def _findings() -> Iterator[Finding]:
    yield from check_devices(plugged_in())
    yield from check_groups(*this_user())
    yield from check_latency()
    yield tried("clock", lambda: check_clock(ask_kernel_clock()))
    yield check_detection(len(os.sched_getaffinity(0)))
    yield check_kernels()
    yield tried("disk", lambda: check_disk(Path.cwd()))


def _told(finding: Finding) -> dict[str, object]:
    return {"about": finding.about, "health": finding.health.value, "says": finding.says, "cure": finding.cure or None}


def _table(findings: list[Finding]) -> Table:
    table = Table("", "what", "finding", "cure")
    for finding in findings:
        mark = f"[{COLOURS[finding.health]}]{finding.health.value}[/]"
        table.add_row(mark, finding.about, escape(finding.says), escape(finding.cure))
    return table
