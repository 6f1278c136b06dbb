"""Lenses as other programs write them: ROS's camera_info, OpenCV's FileStorage, Kalibr's camchain.

All of them have OpenCV's pixels, the centre of the first at (0, 0), and coefficients in its order. None knows
``r_max``; what one cannot say is refused rather than left out. Sources: sensor_msgs/CameraInfo, REP 104; OpenCV core,
FileStorage, and its calibration sample; Kalibr's wiki, "YAML formats".
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
import yaml
from pydantic import ValidationError

from camrig.config.lenses import LensModel
from camrig.errors import InputError

_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1")
_COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D", "D1")
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_FISHEYE_SWITCH = "fisheye_model"
"""What OpenCV's own calibration sample writes."""

_BY_ROS = {"plumb_bob": "brown", "rational_polynomial": "brown", "equidistant": "fisheye", "fisheye": "fisheye"}
_BY_KALIBR = {"radtan": "brown", "none": "brown", "equidistant": "fisheye", "equi": "fisheye"}


class LensFormat(StrEnum):
    """Whose file it is."""

    ROS = "ros"
    OPENCV = "opencv"
    KALIBR = "kalibr"


def read_lenses(
    text: str, name: str, size_px: tuple[int, int] | None = None
) -> tuple[LensFormat, dict[str, LensModel]]:
    """Read the lenses of a file; ``name`` is that of one that has none, ``size_px`` the size where the file has none.

    Raises InputError, in a sentence, for what is none of the formats, or a lens that camrig does not know.
    """
    if text.lstrip().startswith(("%YAML:1.0", "<?xml", "{")) or "!!opencv-matrix" in text:
        return LensFormat.OPENCV, {name: _opencv(text, size_px)}
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"is no YAML: {str(error).splitlines()[0]}") from error
    if isinstance(data, dict) and "distortion_model" in data and "camera_matrix" in data:
        return LensFormat.ROS, {str(data.get("camera_name") or name): _ros(data)}
    if isinstance(data, dict) and any(_is_kalibrs(each) for each in data.values()):
        return LensFormat.KALIBR, {str(key): _kalibr(each) for key, each in data.items() if _is_kalibrs(each)}
    raise InputError("is neither ROS's camera_info, nor OpenCV's FileStorage, nor a camchain of Kalibr")


def write_lens(lens: LensModel, name: str, how: LensFormat) -> str:
    """Write a lens. Raises InputError for one that the format has no words for."""
    if how is LensFormat.ROS:
        return _as_ros(lens, name)
    return _as_opencv(lens) if how is LensFormat.OPENCV else _as_kalibr(lens, name)


def _ros(data: Mapping[str, Any]) -> LensModel:
    model = _BY_ROS.get(str(data["distortion_model"]))
    if model is None:
        raise InputError(f"distortion_model is one of {', '.join(_BY_ROS)}, not {data['distortion_model']}")
    try:
        fx, _, cx, _, fy, cy, *_ = map(float, data["camera_matrix"]["data"])
        coefficients = tuple(map(float, data["distortion_coefficients"]["data"]))
        size = (int(data["image_width"]), int(data["image_height"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"camera_info lacks or spoils {error}") from error
    return _model(model, size, (fx, fy), (cx, cy), coefficients)


def _is_kalibrs(section: object) -> bool:
    return isinstance(section, dict) and "intrinsics" in section and "camera_model" in section


def _kalibr(section: Mapping[str, Any]) -> LensModel:
    model = _BY_KALIBR.get(str(section.get("distortion_model")))
    if section["camera_model"] != "pinhole" or model is None:
        raise InputError(
            f"camera_model {section['camera_model']} with {section.get('distortion_model')} is no lens of camrig: "
            "calibrate with pinhole-radtan or pinhole-equi"
        )
    try:
        fx, fy, cx, cy = map(float, section["intrinsics"])
        coefficients = tuple(map(float, section.get("distortion_coeffs") or ()))
        width, height = map(int, section["resolution"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"the camchain lacks or spoils {error}") from error
    return _model(model, (width, height), (fx, fy), (cx, cy), coefficients)


def _opencv(text: str, size_px: tuple[int, int] | None) -> LensModel:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        K = _first(storage, _MATRIX)
        coefficients = _first(storage, _COEFFICIENTS)
        width, height = (_first(storage, names) for names in (_WIDTH, _HEIGHT))
        fisheye = bool(storage.getNode(_FISHEYE_SWITCH).real()) if _has(storage, _FISHEYE_SWITCH) else False
        storage.release()
    except (cv2.error, SystemError) as error:
        raise InputError("is no FileStorage that OpenCV can read") from error
    if K is None or np.shape(K) != (3, 3):
        raise InputError(f"has no 3x3 matrix named {', '.join(_MATRIX)}")
    try:
        size = (int(width), int(height)) if width is not None and height is not None else size_px
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"width and height are whole numbers, not {width} and {height}") from error
    if size is None:
        raise InputError("does not say of what size pictures are: give it, --size-px WIDTHxHEIGHT")
    numbers = () if coefficients is None else tuple(np.ravel(coefficients).tolist())
    return _model("fisheye" if fisheye else "brown", size, (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), numbers)


def _has(storage: cv2.FileStorage, key: str) -> bool:
    return not storage.getNode(key).empty()


def _first(storage: cv2.FileStorage, names: tuple[str, ...]) -> Any:
    """Return what stands under the first of some names that is there: a matrix or a number."""
    node = next((storage.getNode(name) for name in names if _has(storage, name)), None)
    if node is None:
        return None
    return node.mat() if node.isMap() or node.isSeq() else node.real()


def _model(
    model: str, size_px: tuple[int, int], focal: tuple[float, float], centre: tuple[float, float], k: tuple[float, ...]
) -> LensModel:
    try:
        return LensModel.model_validate(
            {"model": model, "size_px": size_px, "fx": focal[0], "fy": focal[1], "cx": centre[0], "cy": centre[1],
             "distortion": k}
        )  # fmt: skip
    except ValidationError as error:
        said = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
        raise InputError(f"holds no lens that camrig can have: {said}") from error


def _matrix(lens: LensModel) -> list[float]:
    return [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]


def _as_ros(lens: LensModel, name: str) -> str:
    coefficients = list(lens.distortion)
    if lens.model == "fisheye":
        model, coefficients = "equidistant", coefficients or [0.0] * 4
    elif len(coefficients) <= 5:
        model, coefficients = "plumb_bob", coefficients + [0.0] * (5 - len(coefficients))
    elif len(coefficients) == 8:
        model = "rational_polynomial"
    else:
        raise InputError("ROS's camera_info has no words for the thin prism of this lens (s1 to s4)")
    K = _matrix(lens)
    data = {
        "image_width": lens.size_px[0],
        "image_height": lens.size_px[1],
        "camera_name": name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": [*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0]},
    }
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)


def _as_opencv(lens: LensModel) -> str:
    storage = cv2.FileStorage("lens.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", lens.size_px[0])
    storage.write("image_height", lens.size_px[1])
    storage.write("camera_matrix", np.reshape(_matrix(lens), (3, 3)))
    storage.write("distortion_coefficients", np.reshape(lens.distortion or (0.0,) * 4, (-1, 1)))
    if lens.model == "fisheye":
        storage.write(_FISHEYE_SWITCH, 1)
    return str(storage.releaseAndGetString())


def _as_kalibr(lens: LensModel, name: str) -> str:
    coefficients = list(lens.distortion[:4]) + [0.0] * (4 - len(lens.distortion[:4]))
    if lens.model == "brown" and any(lens.distortion[4:]):
        raise InputError("Kalibr's radtan has k1 k2 p1 p2 alone, and this lens has more: calibrate with fewer")
    data = {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [lens.fx, lens.fy, lens.cx, lens.cy],
            "distortion_model": "equidistant" if lens.model == "fisheye" else "radtan",
            "distortion_coeffs": coefficients,
            "resolution": list(lens.size_px),
            "rostopic": f"/{name}/image_raw",
        }
    }
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)
