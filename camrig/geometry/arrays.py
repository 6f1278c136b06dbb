"""Names for the arrays that flow through the geometry; shapes stand in the docstrings of their users."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""float64 array of any shape."""

Transform = npt.NDArray[np.float64]
"""(4, 4) rigid transform named target first: ``T_world_camera`` maps camera points into the world."""

GreyImage = npt.NDArray[np.uint8]
"""(height, width) grey picture."""

Numbers = Any
"""A number or an array of them: formulas that serve both (geometry.jit)."""

Coefficients = Sequence[float] | Array
"""A lens's coefficients, in OpenCV's order."""
