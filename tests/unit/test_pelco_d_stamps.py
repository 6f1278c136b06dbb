"""When a head sampled what it reports."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig_drivers.pelco_d.codec import Extended, Op
from camrig_drivers.pelco_d.timing import timed

REPLY = Extended(1, Op.PAN, 0, 0)


@pytest.mark.parametrize("baud", [2400, 9600, 115200])
def test_the_stamp_is_the_middle_between_question_and_answer(baud: int) -> None:
    frame_s = 70.0 / baud
    written_s, think_s = 100.0, 0.012
    heard_s = written_s + frame_s + think_s + frame_s
    answer = timed(REPLY, written_s + frame_s, heard_s, frame_s)
    assert answer is not None
    assert answer.stamp_s == pytest.approx(written_s + frame_s + think_s / 2.0)
    assert answer.half_window_s == pytest.approx(think_s / 2.0)


def test_a_uart_two_percent_fast_is_still_believed() -> None:
    answer = timed(REPLY, 0.0, 0.98 * 0.029, 0.029)
    assert answer is not None
    assert answer.half_window_s == 0.0


@given(early_s=st.floats(0.001, 0.1))
def test_what_began_before_the_question_ended_answers_another(early_s: float) -> None:
    assert timed(REPLY, 0.0, 0.029 - early_s, 0.029) is None
