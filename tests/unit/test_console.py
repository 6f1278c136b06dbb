"""What goes to standard output: one JSON object a line, whatever the numbers are."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.cli.console import note, print_json, progress_bar

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def test_what_is_not_finite_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": math.nan, "b": [1.5, -math.inf, (np.float64("nan"), True)], "c": {"d": {"e": math.inf}}, "f": 0})
    out = capsys.readouterr().out
    assert out.endswith("\n")
    assert json.loads(out) == {"a": None, "b": [1.5, None, [None, True]], "c": {"d": {"e": None}}, "f": 0}


def test_it_is_one_line_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"text": "line\nbreak", "name": "Tür"})
    captured = capsys.readouterr()
    assert captured.out == '{"text": "line\\nbreak", "name": "Tür"}\n'
    assert captured.err == ""


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_any_answer_is_strict_json(answer: dict[str, object]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        written: list[str] = []
        patch.setattr("sys.stdout.write", written.append)
        print_json(answer)
    assert set(json.loads("".join(written), parse_constant=pytest.fail)) == set(answer)


def test_a_progress_bar_is_for_terminals_and_never_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("demo", total=2.0) as progress:
        progress.advance(progress.task_ids[0], 2.0)
        assert progress.finished
    assert capsys.readouterr().out == ""


def test_a_notes_brackets_are_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    note("pip install 'camrig[ipopt]' to have it [too]")
    captured = capsys.readouterr()
    assert captured.err == "note: pip install 'camrig[ipopt]' to have it [too]\n"
    assert captured.out == ""
