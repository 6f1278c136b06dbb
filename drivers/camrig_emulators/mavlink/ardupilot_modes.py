"""ArduCopter's flight modes, as HEARTBEAT's custom_mode tells them."""

from __future__ import annotations

STABILIZE, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, LAND, POSHOLD, BRAKE, GUIDED_NOGPS = 0, 2, 3, 4, 5, 6, 9, 16, 17, 20
MODES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    AUTO: "AUTO",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    LAND: "LAND",
    POSHOLD: "POSHOLD",
    BRAKE: "BRAKE",
    GUIDED_NOGPS: "GUIDED_NOGPS",
}
