"""The language in which faults are scripted."""

import pytest

from camrig.errors import InputError
from camrig_emulators.fault_script import FaultScript
from camrig_emulators.pelco_d_bench import Bench
from tests.head_on_bench import head

HEADS = {"pt1", "pt2"}


def test_a_script_is_what_happens_in_order() -> None:
    text = "at 5 unplug  # pulled\nfrom 1 to 2.5 on pt2 latency 0.2; at 0 drop 3\n\n"
    script = FaultScript.parse(text, 100.0, HEADS)
    assert script.next_s() == 100.0
    happened = [(each.stamp_s, each.name, each.value, each.head) for each in script.due(200.0)]
    assert happened == [
        (100.0, "drop", 3.0, None),
        (101.0, "latency", 0.2, "pt2"),
        (102.5, "latency", 0.0, "pt2"),
        (105.0, "unplug", 1.0, None),
    ]
    assert script.next_s() is None


@pytest.mark.parametrize(
    ("statement", "why"),
    [
        ("silent", "write 'at SECONDS FAULT'"),
        ("at x silent", "write 'at SECONDS FAULT'"),
        ("at 1 vanish", "'vanish' is none of"),
        ("from 1 to 2 unplug", "'unplug' is none of"),
        ("at 1 garble", "garble needs a number"),
        ("at 1 silent 3", "silent takes no number"),
        ("at 1 on pt9 silent", "there is no head 'pt9', but pt1, pt2"),
        ("at 1 on pt1 unplug", "unplug happens to the line"),
        ("from 2 to 1 silent", "ends before it begins"),
        ("at 1.2.3 silent", "a number is written like 2 or 2.5"),
        ("at 1 lose 7", "lose takes a probability"),
    ],
)
def test_a_wrong_statement_is_named_with_what_is_wrong(statement: str, why: str) -> None:
    with pytest.raises(InputError) as refused:
        FaultScript.parse(f"at 0 silent; {statement}", 0.0, HEADS)
    assert f"'{statement}'" in str(refused.value)
    assert why in str(refused.value)


def test_scripted_faults_happen_to_the_line_and_to_one_head() -> None:
    bench = Bench(head("pt1"), head("pt2", address=2), script="from 1 to 2 on pt1 silent; at 3 on pt2 reset")
    bench.wait(1.1)
    assert bench.ask(1, 0x51) == b""
    assert len(bench.ask(2, 0x51)) == 7
    bench.wait(1.0)
    assert len(bench.ask(1, 0x51)) == 7
    assert bench.ask(2, 0x51) == b"", "deaf after its brown-out"
