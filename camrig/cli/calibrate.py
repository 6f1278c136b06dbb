"""``camrig calibrate``: find out what a rig is really like. One module a calibration."""

from __future__ import annotations

import typer

from camrig.cli.calibrate_board import board
from camrig.cli.calibrate_body import body
from camrig.cli.calibrate_check import check
from camrig.cli.calibrate_extrinsics import extrinsics
from camrig.cli.calibrate_head import head
from camrig.cli.calibrate_intrinsics import intrinsics
from camrig.cli.lens_exchange import export_lens, import_lens

calibrate = typer.Typer(help="Find out what a rig is really like.", no_args_is_help=True, rich_markup_mode="markdown")


@calibrate.callback()
def _no_calibration() -> None:
    """Do nothing: every calibration stands for itself."""


calibrate.command()(board)
calibrate.command()(intrinsics)
calibrate.command()(extrinsics)
calibrate.command()(head)
calibrate.command()(body)
calibrate.command()(check)
calibrate.command("import")(import_lens)
calibrate.command("export")(export_lens)
