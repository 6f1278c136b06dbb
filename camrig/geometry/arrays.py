"""Names for the arrays that flow through the geometry; shapes stand in the docstrings of their users."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""float64 array of any shape."""

Transform = npt.NDArray[np.float64]
"""(4, 4) rigid transform named target first: ``T_world_camera`` maps camera points into the world."""

GreyImage = npt.NDArray[np.uint8]
"""(height, width) grey picture."""
