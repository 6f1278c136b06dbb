"""Stop every head of a rig without a daemon: the second net, after the guardian."""

from __future__ import annotations

from collections.abc import Mapping

from camrig.config.rig_file import RigConfig
from camrig.errors import HardwareError
from camrig.runtime.build import make_devices


def stop_heads(config: RigConfig) -> Mapping[str, str]:
    """Open every head (which stops it) and stop it again; return what went wrong, by head."""
    unreached: dict[str, str] = {}
    for name, head in make_devices(config, "heads").items():
        try:
            head.open()
            head.stop()
        except HardwareError as error:
            unreached[name] = str(error)
        finally:
            head.close()
    return unreached
