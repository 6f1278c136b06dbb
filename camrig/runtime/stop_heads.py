"""Stop every head of a rig without a daemon: the second net, after the guardian."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

from camrig.config.rig_file import RigConfig
from camrig.errors import HardwareError
from camrig.interfaces import Head
from camrig.runtime.build import make_devices


def stop_heads(config: RigConfig) -> Mapping[str, str]:
    """Open every head (which stops one that does not answer) and stop it; return what went wrong, by head.

    All at once: a head that keeps silent delays no other's stop by its time-outs.
    """
    heads = make_devices(config, "heads")
    with ThreadPoolExecutor(max(1, len(heads))) as pool:
        troubles = dict(zip(heads, pool.map(_stop, heads.values()), strict=True))
    return {name: trouble for name, trouble in troubles.items() if trouble}


def _stop(head: Head) -> str:
    try:
        head.open()
        head.stop()
    except HardwareError as error:
        return str(error)
    finally:
        head.close()
    return ""
