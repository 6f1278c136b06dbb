"""The sensing-quality model: what one camera makes of one target, what it sees, and how cameras add up. Pure."""

from camrig.sensing.quality import fused, pixel_quality, q_d, q_p
from camrig.sensing.visibility import (
    cone_clearance,
    half_angle,
    image_clearance,
    in_cone,
    in_image,
    tag_corners,
    tag_side_px,
)

__all__ = [
    "cone_clearance",
    "fused",
    "half_angle",
    "image_clearance",
    "in_cone",
    "in_image",
    "pixel_quality",
    "q_d",
    "q_p",
    "tag_corners",
    "tag_side_px",
]
