"""The state of a running rig in one line, for systemd and the terminal."""

from __future__ import annotations

from camrig.rig import Rig
from camrig.runtime.control import Control


def status_line(rig: Rig, control: Control, remark: str) -> str:
    """Return what is done, of how many targets, which links are lost, and ``remark`` at the end."""
    published = control.latest
    tracked = sum(target.status.value == "tracked" for target in published.targets) if published else 0
    lost = sorted(name for name, status in control.link_states.items() if status.value == "lost")
    phase = "scanning" if control.state.mission.scanning else "tracking"
    text = f"{phase}: {tracked} of {len(rig.targets)} targets"
    return "; ".join((text, *([f"lost: {', '.join(lost)}"] if lost else []), *([remark] if remark else [])))
