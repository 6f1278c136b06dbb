"""``camrig install-service``: puts the systemd units, the user and the udev rules in place, and says what it did."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from camrig.cli.console import print_json, results
from camrig.runtime.service_files import Service, default_program


def install_service(
    root: Annotated[Path, typer.Option(help="Put the files under this folder and tell no running system.")] = Path("/"),
    program: Annotated[
        Path | None, typer.Option(help="The camrig that the service starts (default: this one).")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Install camrig as a systemd service; starts and enables nothing. Again after an update: it says what changed."""
    service = Service(root, program or default_program())
    steps = service.plan() if dry_run else service.install()
    if as_json:
        print_json({"dry_run": dry_run, "steps": [{"what": step.what, "state": step.state} for step in steps]})
        return
    if dry_run:
        results.print("nothing is done; this would be:")
    for step in steps:
        results.print(f"{step.state:9} {step.what}", soft_wrap=True, markup=False, highlight=False)
    if not dry_run and root == Path("/"):
        results.print("next: write /etc/camrig/rig.yaml, camrig check it, then systemctl enable --now camrig")
