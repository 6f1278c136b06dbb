"""One line for several heads: fairness, how soon a stop is out, how long replies are waited for, what is counted."""

import math
import random
from contextlib import ExitStack

import numpy as np

from camrig.errors import NotEnabledError
from tests.simulated_line import SimulatedHeads

STOP_1 = bytes.fromhex("ff010000000001")


def test_four_heads_on_one_line_are_polled_fairly_and_a_stop_is_out_within_60_ms() -> None:
    rig = SimulatedHeads(4, 9600, seed=2)
    rng, ending, waits_s = random.Random(2), [False], []

    def work(number: int) -> None:
        head = rig.heads[number]
        while not ending[0]:
            try:
                head.move_to(math.radians(rng.uniform(-100.0, 100.0)), math.radians(rng.uniform(-80.0, 0.0)))
                head.read(0.3)
            except NotEnabledError:
                head.enable()

    for head in rig.heads:
        head.open()
        head.enable()
    with ExitStack() as stack:
        for number in range(4):
            stack.enter_context(rig.time.running(f"pt{number + 1}", lambda number=number: work(number)))  # type: ignore[misc]
        rig.time.sleep_s(30.0)
        rig.truth_deg()
        asked = [frame[1] for _, frame in rig.line.received if frame[3] == 0x51]
        for _ in range(400):
            rig.time.sleep_s(rng.uniform(0.3, 0.9))
            asked_s = rig.time.now_s()
            rig.head.stop()
            rig.time.sleep_s(0.1)
            rig.truth_deg()
            waits_s.append(
                min(end_s - asked_s for end_s, frame in rig.line.received if frame == STOP_1 and end_s > asked_s)
            )
        ending[0] = True
    counts = [asked.count(address) for address in (1, 2, 3, 4)]
    assert float(np.percentile(waits_s, 99)) <= 0.06
    assert max(counts) - min(counts) <= 0.1 * max(counts), counts
    for head in rig.heads:
        head.close()


def test_replies_are_waited_for_as_long_as_this_head_takes() -> None:
    rig = SimulatedHeads(keys={"reply_timeout_s": 0.3}, reply_latency_s=0.005)
    rig.head.open()
    assert rig.head.statistics()["timeout_s"] == 0.3
    rig.poll(3.0)
    learnt = rig.head.statistics()
    assert learnt["timeout_s"] == 0.08
    assert abs(learnt["reply_s"] - 0.005) < 0.001
    rig.line.faults.latency_s = 0.12
    late = rig.poll(4.0)
    assert len(late) > 10, "after a miss it waits as long as allowed, and learns anew"
    assert rig.head.statistics()["silent"] >= 1
    rig.head.close()


def test_a_links_exchanges_are_counted() -> None:
    rig = SimulatedHeads()
    assert rig.head.statistics() == {}
    rig.head.open()
    rig.head.enable()
    rig.move(10.0, -10.0)
    rig.poll(1.0)
    rig.head.stop()
    counted = rig.head.statistics()
    assert counted["asked"] == counted["answered"] > 6
    assert (counted["moves"], counted["stops"], counted["silent"], counted["disbelieved"]) == (2, 1, 0, 0)
    rig.head.close()
