"""Claimed stamps against the truth: a rolling shutter that exposes a light whose brightness is the time.

Every row is exposed from its own beginning on and holds the brightness of the middle of its exposure, so that a
picture tells by itself when it was taken.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.clock import ManualClock
from camrig.geometry.lens import BrownLens
from camrig.rig import CameraSpec, FreeMount
from camrig_drivers.v4l2 import V4l2Camera, V4l2Section
from tests.v4l2_hub import Hub, camera_at
from tests.v4l2_kernel import MONOTONIC, START_OF_EXPOSURE, Habits

SIZE_PX = (64, 480)
SWEEP_S = 0.1
"""The light goes from black to white in this time: 0.4 ms a grey level."""
LATENCY_S = 0.05
EXPOSURE_UNIT_S = 1e-4


def brightness(at_s: np.ndarray, dark_s: float) -> np.ndarray:
    return np.clip(np.rint(255.0 * (at_s - dark_s) / SWEEP_S), 0, 255).astype(np.uint8)


@given(
    begin_s=st.floats(1.0, 1e5),
    exposure=st.integers(1, 300),
    readout_s=st.sampled_from([0.0, 0.004, 0.017, 0.033]),
    at_start=st.booleans(),
)
def test_a_claimed_stamp_is_the_true_time_of_the_middle_row(
    begin_s: float, exposure: int, readout_s: float, at_start: bool
) -> None:
    exposure_s = exposure * EXPOSURE_UNIT_S
    rows_s = begin_s + readout_s * np.linspace(0.0, 1.0, SIZE_PX[1]) + exposure_s / 2.0
    dark_s = rows_s[0] - 0.01
    picture = np.repeat(brightness(rows_s, dark_s)[:, None], SIZE_PX[0], axis=1)
    end_s = begin_s + readout_s + exposure_s

    kernel = camera_at("/dev/video0", "usb-1", habits=Habits(formats={"GREY": (SIZE_PX,)}))
    kernel.clock = ManualClock(end_s + LATENCY_S)
    spec = CameraSpec("north", BrownLens(SIZE_PX, (60.0, 60.0), (31.5, 239.5)), FreeMount(), readout_s)
    controls = {"auto_exposure": "manual", "exposure_time_absolute": exposure}
    section = V4l2Section.model_validate({"device": "/dev/video0", "format": "GREY", "controls": controls})
    camera = V4l2Camera(spec, section, kernel.clock, Hub([kernel]))
    camera.open()
    flags = MONOTONIC | (START_OF_EXPOSURE if at_start else 0)
    kernel.expose(picture.tobytes(), begin_s if at_start else end_s, flags)
    frame = camera.read(0.0)
    camera.close()

    assert frame is not None
    assert frame.stamp_known
    middle = frame.image[SIZE_PX[1] // 2 - 1 : SIZE_PX[1] // 2 + 1].mean()
    true_s = dark_s + SWEEP_S * float(middle) / 255.0
    assert frame.stamp_s == pytest.approx(true_s, abs=1e-3)
