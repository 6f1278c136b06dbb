"""PX4's gimbal module, where one runs."""

from __future__ import annotations

from camrig_emulators.mavlink.cockpit import ACCEPTED, DENIED
from camrig_emulators.mavlink.commands import Cmd
from camrig_emulators.mavlink.firmware import CommandParams, whole
from camrig_emulators.mavlink.mount import Mount


def px4_gimbal(mount: Mount | None, command: int, params: CommandParams) -> int | None:
    """Carry out a gimbal command; returns the MAV_RESULT, None where no module runs and so nobody answers.

    The manager's commands need control, taken by DO_GIMBAL_MANAGER_CONFIGURE; DO_MOUNT_CONTROL takes it by itself.
    """
    if mount is None:
        return None
    if command == Cmd.GIMBAL_CONFIGURE:
        taken = (whole(params[0]), whole(params[1]))
        mount.owner = taken if all(0 < number < 256 for number in taken) else mount.owner
        return ACCEPTED
    if command == Cmd.MOUNT_CONTROL:
        mount.point(params[0], params[2], 0)
        return ACCEPTED
    if mount.owner is None:
        return DENIED
    mount.point(params[0], params[1], whole(params[4]))
    return ACCEPTED
