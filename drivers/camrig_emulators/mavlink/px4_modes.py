"""PX4's flight modes, as HEARTBEAT's custom_mode tells them."""

from __future__ import annotations


def custom_mode(main: int, sub: int = 0) -> int:
    """Pack PX4's main and sub mode."""
    return main << 16 | sub << 24


MANUAL, ALTCTL, POSCTL, OFFBOARD = (custom_mode(main) for main in (1, 2, 3, 6))
TAKEOFF, HOLD, MISSION, RTL, LAND = (custom_mode(4, sub) for sub in (2, 3, 4, 5, 6))
MODES = {
    MANUAL: "Manual",
    ALTCTL: "Altitude",
    POSCTL: "Position",
    OFFBOARD: "Offboard",
    HOLD: "Hold",
    TAKEOFF: "Takeoff",
    MISSION: "Mission",
    RTL: "Return",
    LAND: "Land",
}
