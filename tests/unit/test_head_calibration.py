"""A head that its file knows next to nothing of is calibrated in simulated time, and points well afterwards."""

import math

import numpy as np
import pytest

from tests.head_study import numbers, pointing_errors_deg, study


@pytest.mark.parametrize("seed", [5])
def test_everything_is_found_and_the_driver_points_well_with_it(seed: int) -> None:
    result, rig = study(seed, anchored=True)
    assert [row for row in numbers(result) if row.off > row.bar] == []
    assert result.verdict == "green"
    assert result.moving_s < 240.0
    assert rig.motions()[-1] == "stop"
    errors = pointing_errors_deg(result, rig, 20, seed)
    assert errors.max() <= 0.1
    assert math.degrees(result.pointing_rad) == pytest.approx(float(np.sqrt(np.mean(errors**2))), abs=0.02)
