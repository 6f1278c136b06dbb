"""A folder, glob or video as a camera."""

from camrig.interfaces import Camera, Driver
from camrig.rig import CameraSpec
from camrig_drivers.images.camera import ImagesCamera, check, make
from camrig_drivers.images.section import ImagesSection

driver: Driver[CameraSpec, Camera] = Driver(ImagesSection, make, check)

__all__ = ["ImagesCamera", "ImagesSection", "driver"]
