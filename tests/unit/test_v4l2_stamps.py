"""Buffer stamps to mid-exposure of the centre row, against a rolling shutter told row by row."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_drivers.v4l2.stamps import mid_exposure
from tests.v4l2_kernel import COPY, MONOTONIC, START_OF_EXPOSURE

UNKNOWN_CLOCK = 0
OTHER_SOURCE = 0x20000
LATER_S = 1000.0

times_s = st.floats(0.0, 0.1)


def at(stamp_s: float, *, known: bool) -> object:
    """Equals a stamp of that time."""
    return pytest.approx((stamp_s, float(known)), abs=1e-9)


@given(begin_s=st.floats(0.0, 900.0), exposure_s=st.floats(1e-5, 0.1), readout_s=times_s, rows=st.integers(1, 500))
def test_both_kinds_of_stamp_mean_the_middle_row(
    begin_s: float, exposure_s: float, readout_s: float, rows: int
) -> None:
    """Row r begins at begin + readout * r / (rows - 1); frames end with the exposure of their last row."""
    begins_s = [begin_s + readout_s * row / max(1, rows - 1) for row in range(rows)]
    first, last = (begins_s[0], begins_s[-1]) if rows > 1 else (begin_s, begin_s + readout_s)
    centre_s = (first + last) / 2.0 + exposure_s / 2.0
    start = mid_exposure(first, MONOTONIC | START_OF_EXPOSURE, LATER_S, exposure_s=exposure_s, readout_s=readout_s)
    end = mid_exposure(last + exposure_s, MONOTONIC, LATER_S, exposure_s=exposure_s, readout_s=readout_s)
    assert start == at(centre_s, known=True)
    assert end == at(centre_s, known=True)


def test_an_unknown_exposure_leaves_the_readout_and_is_said() -> None:
    assert mid_exposure(10.0, MONOTONIC, LATER_S, exposure_s=None, readout_s=0.02) == at(9.99, known=False)
    start = MONOTONIC | START_OF_EXPOSURE
    assert mid_exposure(10.0, start, LATER_S, exposure_s=None, readout_s=0.02) == at(10.01, known=False)


@pytest.mark.parametrize("clock", [UNKNOWN_CLOCK, COPY, COPY | START_OF_EXPOSURE])
def test_a_stamp_of_another_clock_is_not_used(clock: int) -> None:
    """A wall-clock stamp among monotonic ones would throw the fusion fifty years ahead."""
    stamp = mid_exposure(1.7e9, clock, 50.0, exposure_s=0.01, readout_s=0.02)
    assert stamp == at(50.0 - 0.015, known=False)


@pytest.mark.parametrize("clock", [UNKNOWN_CLOCK, COPY])
def test_a_recent_stamp_of_a_clock_without_a_name_is_ours(clock: int) -> None:
    """v4l2loopback names no clock; its pictures may be handed on long after they were taken."""
    assert mid_exposure(49.2, clock, 50.0, exposure_s=0.01, readout_s=0.02) == at(49.2 - 0.015, known=False)
    assert mid_exposure(30.0, clock, 50.0, exposure_s=0.01, readout_s=0.02) == at(50.0 - 0.015, known=False)


def test_a_stamp_of_the_future_is_not_used() -> None:
    assert mid_exposure(50.03, MONOTONIC, 50.0, exposure_s=0.01, readout_s=0.0) == at(49.995, known=False)


def test_a_kind_of_stamp_that_is_not_known_is_said() -> None:
    assert mid_exposure(10.0, MONOTONIC | OTHER_SOURCE, LATER_S, exposure_s=0.01, readout_s=0.0) == at(
        10.0, known=False
    )
