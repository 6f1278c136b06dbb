"""Plans as pictures: rooms from above, what each camera covers, who sees what, and how well any place is sensed.

What draws is imported late: matplotlib comes with the extra ``camrig[pictures]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from camrig.errors import InputError
from camrig.messages import RigPlan
from camrig.optimise import Scene
from camrig.optimise.scene import Quality

QUALITY_UNITS: dict[Quality, str] = {"pixel": "mm/px", "fisher": "mm rms", "perspective": "mm/px"}
"""What people read the qualities in, which are metres inside."""

_ENDINGS = (".svg", ".png")


def check_picture(path: Path) -> None:
    """Raise InputError where no picture can be written to ``path``: before anything is planned for it."""
    if path.suffix.lower() not in _ENDINGS:
        raise InputError(f"{path}: pictures are written as {' or '.join(_ENDINGS)}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    _figures()


def write_plan_map(path: Path, title: str, scene: Scene, plan: RigPlan) -> None:
    """Draw a plan to a picture file; raises InputError where it cannot be written."""
    check_picture(path)
    _figures().write_map(path, title, scene, plan)


def plan_panel(path: Path, panels: Sequence[tuple[str, Scene, RigPlan]]) -> None:
    """Draw several plans with their titles side by side to a picture file, as ``write_plan_map`` does one."""
    check_picture(path)
    _figures().write_panel(path, panels)


def _figures() -> ModuleType:
    try:
        from camrig.report import plan_figure  # noqa: PLC0415 - matplotlib is an extra
    except ImportError as error:
        raise InputError("pictures need matplotlib, which is not installed; install camrig[pictures]") from error
    return plan_figure
