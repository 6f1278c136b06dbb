"""Cameras on V4L2 devices of the Linux kernel."""

from camrig.interfaces import Camera, Driver
from camrig.rig import CameraSpec
from camrig_drivers.v4l2.camera import V4l2Camera, make
from camrig_drivers.v4l2.discovery import discover
from camrig_drivers.v4l2.section import V4l2Section, check

driver: Driver[CameraSpec, Camera] = Driver(section=V4l2Section, make=make, check=check, discover=discover)

__all__ = ["V4l2Camera", "V4l2Section", "driver"]
