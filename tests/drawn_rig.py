"""Pictures of tags that stand or are carried, as a camera with any lens would take them; for tests of calibrations."""

from __future__ import annotations

import cv2
import numpy as np

from camrig.geometry.arrays import GreyImage, Transform
from camrig.geometry.lens import Lens
from camrig.geometry.pnp import TAG_CORNERS
from camrig.geometry.pose import apply, invert
from camrig.rig import TagKey
from camrig_emulators.tag_pictures import tag_texture


def drawn(lens: Lens, T_world_camera: Transform, tags: dict[int, tuple[Transform, float]]) -> GreyImage:
    """Draw tags four times too large, in their order, and average."""
    scale, (width, height) = 4.0, lens.size_px
    picture = np.full((int(scale * height), int(scale * width)), 110, np.uint8)
    for number, (T_world_tag, size_m) in tags.items():
        texture = tag_texture(TagKey("tag36h11", number), 16)
        rim, far = 15.5, len(texture) - 16.5
        corners = lens.project(apply(invert(T_world_camera) @ T_world_tag, size_m * TAG_CORNERS))
        T_image_texture = cv2.getPerspectiveTransform(
            np.array([[rim, far], [far, far], [far, rim], [rim, rim]], np.float32),
            ((corners + 0.5) * scale - 0.5).astype(np.float32),
        )
        cv2.warpPerspective(
            texture, T_image_texture, picture.shape[::-1], dst=picture, borderMode=cv2.BORDER_TRANSPARENT
        )
    return np.asarray(cv2.resize(picture, lens.size_px, interpolation=cv2.INTER_AREA), np.uint8)
