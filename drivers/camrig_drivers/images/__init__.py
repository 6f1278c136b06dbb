"""A folder, glob or video as a camera."""

from camrig.interfaces import Camera, Driver
from camrig.rig import CameraSpec
from camrig_drivers.images.camera import ImagesCamera, make
from camrig_drivers.images.section import ImagesSection

driver: Driver[CameraSpec, Camera] = Driver(ImagesSection, make)

__all__ = ["ImagesCamera", "ImagesSection", "driver"]
