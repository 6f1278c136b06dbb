"""The sensing-quality model: what one camera makes of one target, what it sees, and how cameras add up. Pure.

Here is what costs nothing to import; the compiled kernels are in the modules beside it.
"""

from camrig.sensing.quality import fused, pixel_quality, q_d, q_p

__all__ = ["fused", "pixel_quality", "q_d", "q_p"]
