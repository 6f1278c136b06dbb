"""Opens every camera of a rig for one picture: what only the devices know is told before the rig runs."""

from __future__ import annotations

from camrig.config.rig_file import RigConfig
from camrig.errors import HardwareError, InputError
from camrig.interfaces import Camera
from camrig.runtime.build import make_devices

_PICTURE_S = 5.0


def try_cameras(config: RigConfig) -> None:
    """Take a picture with each; raises HardwareError with all that failed, InputError on an emulated rig."""
    if config.world is not None:
        raise InputError("the cameras of an emulated rig are there only while it runs; check it without --open")
    cameras = make_devices(config, "cameras")
    faults = [fault for name, camera in cameras.items() if (fault := _fault_of(name, camera))]
    if faults:
        raise HardwareError("\n".join(faults))


def _fault_of(name: str, camera: Camera) -> str:
    try:
        camera.open()
        if camera.read(_PICTURE_S) is None:
            return f"camera {name} opened and gave no picture within {_PICTURE_S:.0f} s"
    except HardwareError as error:
        return str(error)
    finally:
        camera.close()
    return ""
