"""Three backends of ``TagDetector``: two builds of AprilTag's C library, and OpenCV's detector."""

from camrig.interfaces import Plugin, TagDetector
from camrig_drivers.apriltag.c_library import make_pupil, make_pyapriltags
from camrig_drivers.apriltag.opencv import make_opencv
from camrig_drivers.apriltag.sections import OpencvSection, PupilSection, PyapriltagsSection

pyapriltags_driver: Plugin[TagDetector] = Plugin(PyapriltagsSection, make_pyapriltags)
pupil_driver: Plugin[TagDetector] = Plugin(PupilSection, make_pupil)
opencv_driver: Plugin[TagDetector] = Plugin(OpencvSection, make_opencv)

__all__ = ["opencv_driver", "pupil_driver", "pyapriltags_driver"]
