"""Whether a camera keeps its focus: a lens that focuses by itself is another one in every picture."""

from __future__ import annotations

from camrig.config.rig_file import RigConfig
from camrig.errors import InputError

_AUTO_FOCUS = ("focus_automatic_continuous", "focus_auto")


def check_focus(config: RigConfig, camera_id: str) -> None:
    """Raise InputError where a camera, which is open and set as its file says, focuses by itself."""
    if _focuses_by_itself(config, camera_id):
        raise InputError(
            f"camera '{camera_id}' focuses by itself, and its lens is another each time: put `lock: [focus]` into its "
            "source, and calibrate again"
        )


def _focuses_by_itself(config: RigConfig, camera_id: str) -> bool:
    """Ask the device; one that cannot be asked does not."""
    source = config.devices["cameras"][camera_id]
    wanted = source.raw.get("device")
    if source.driver.discover is None or wanted is None:
        return False
    for found in source.driver.discover():
        names, controls = found.facts.get("names"), found.facts.get("controls")
        if isinstance(names, list) and wanted in names and isinstance(controls, dict):
            return any(bool(controls.get(name, {}).get("value")) for name in _AUTO_FOCUS)
    return False
