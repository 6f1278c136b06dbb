"""Lens models behind one interface: Brown-Conrady and OpenCV's fisheye."""

from camrig.geometry.lens.brown import BrownLens
from camrig.geometry.lens.fisheye import FisheyeLens
from camrig.geometry.lens.interface import Lens

__all__ = ["BrownLens", "FisheyeLens", "Lens"]
