"""A head that its file knows next to nothing of is calibrated in simulated time, and points well afterwards."""

import math

import numpy as np
import pytest

from tests.head_study import PAN_LIMITS_DEG, TILT_LIMITS_DEG, numbers, pointing_errors_deg, study


@pytest.mark.parametrize("seed", [5])
def test_everything_is_found_and_the_driver_points_well_with_it(seed: int) -> None:
    result, rig, eye = study(seed, anchored=True)
    assert [row for row in numbers(result) if row.off > row.bar] == []
    assert result.verdict == "green"
    assert result.moving_s < 240.0
    assert rig.motions()[-1] == "stop"
    low_deg, high_deg = np.min(eye.angles_deg, axis=0), np.max(eye.angles_deg, axis=0)
    assert all(low_deg >= [PAN_LIMITS_DEG[0], TILT_LIMITS_DEG[0]])
    assert all(high_deg <= [PAN_LIMITS_DEG[1], TILT_LIMITS_DEG[1]])
    errors = pointing_errors_deg(result, rig, 20, seed)
    assert errors.max() <= 0.1
    assert math.degrees(result.pointing_rad) == pytest.approx(float(np.sqrt(np.mean(errors**2))), abs=0.02)
