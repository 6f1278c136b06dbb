"""The operator's commands, in memory: what is obeyed, what is refused and with which words, what status says."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camrig.geometry.pose import transform
from camrig.locate import Lenses, Refined
from camrig.messages import (
    DroneHealth,
    DroneReading,
    FlightState,
    HeadAim,
    LinkStatus,
    PlanStatus,
    RigPlan,
    TargetStatus,
)
from camrig.pipeline import begin
from camrig.rig import Rig
from camrig.runtime.operator_status import EVENTS_KEPT, RecentEvents
from tests.operator_desk import Desk, refusal, rig, target

ME = "uid 7 pid 8"
COMMANDS = ("status", "hold", "resume", "aim", "arm", "land", "scan")


def test_every_command_reaches_the_daemon() -> None:
    desk = Desk()
    operator = desk.operator()
    assert operator.handle({"command": "hold"}, ME) == {"ok": True, "heads": ["pt1", "pt2"], "drones": ["d1"]}
    assert operator.handle({"command": "resume"}, ME) == {"ok": True, "heads": ["pt1", "pt2"], "unreached": {}}
    assert operator.handle({"command": "resume", "heads": ["pt2"]}, ME)["heads"] == ["pt2"]
    assert operator.handle({"command": "arm", "drone": "d1"}, ME) == {"ok": True}
    assert operator.handle({"command": "land", "drone": "d1"}, ME) == {"ok": True}
    assert operator.handle({"command": "scan"}, ME) == {"ok": True}
    orders = [("hold", ()), ("resume", ("pt1", "pt2")), ("resume", ("pt2",)), ("arm", ("d1",)), ("land", ("d1",))]
    assert desk.done == [*orders, ("scan", ())]


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"command": "resume", "heads": ["pt1", "pt9"]}, "rig 'lab' has no head 'pt9'; its heads are pt1, pt2"),
        ({"command": "arm", "drone": "pt1"}, "rig 'lab' has no drone 'pt1'; its drones are d1"),
        ({"command": "land", "drone": ""}, "rig 'lab' has no drone ''; its drones are d1"),
        ({"command": "fly"}, "'status', 'hold', 'resume', 'aim', 'lend', 'arm', 'land', 'scan'"),
        ({"command": "aim", "head": "pt9", "pan_deg": 1}, "rig 'lab' has no head 'pt9'; its heads are pt1, pt2"),
        ({"command": "aim", "head": "pt1"}, "Give pan_deg, tilt_deg or both"),
        (
            {"command": "aim", "head": "pt1", "pan_deg": 200, "tilt_deg": 0},
            "head 'pt1' is not moved: pan 200 deg is outside its limits, -171.887 to 171.887 deg",
        ),
        (
            {"command": "aim", "head": "pt1", "pan_deg": 0, "tilt_deg": 0.1},
            "tilt 0.1 deg is outside its limits, -85.9437 to 0 deg",
        ),
        ({"command": "aim", "head": "pt1", "pan_deg": float("nan")}, "aim.pan_deg"),
        ({"command": "arm"}, "arm.drone"),
        ({"command": "hold", "head": "pt1"}, "hold.head"),
        ({}, "command"),
        ([], "not understood"),
        ({"command": "arm", "drone": "x" * 5000}, "at most 100 characters"),
    ],
)
def test_what_is_not_understood_is_refused_in_a_sentence_and_moves_nothing(request_: object, says: str) -> None:
    desk = Desk()
    answer = desk.operator().handle(request_, ME)
    assert (answer["ok"], answer["exit_code"]) == (False, 2)
    assert says in str(answer["error"])
    assert len(str(answer["error"])) < 400
    assert desk.done == []


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(), max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
NEARLY = st.builds(
    lambda command, drone, heads, more: {"command": command, "drone": drone, "heads": heads, **more},
    st.sampled_from(COMMANDS) | JSON,
    JSON,
    JSON,
    st.dictionaries(st.text(max_size=4), JSON, max_size=1),
)


@given(JSON | NEARLY)
def test_no_request_whatever_is_more_than_refused(request: object) -> None:
    desk = Desk()
    answer = desk.operator().handle(request, ME)
    assert (answer["ok"], answer["exit_code"], desk.done) == (False, 2, [])
    assert "\n" not in str(answer["error"])
    json.dumps(answer, allow_nan=False)


def test_a_stop_that_did_not_reach_a_device_is_said() -> None:
    desk = Desk(failing={"pt1": "port went away"})
    desk.link("pt2", LinkStatus.LOST, "no answer")
    desk.state = replace(desk.state, links={name: link for name, link in desk.state.links.items() if name != "d1"})
    answer = desk.operator().handle({"command": "hold"}, ME)
    assert desk.done == [("hold", ())]
    assert (answer["ok"], answer["exit_code"]) == (False, 4)
    for words in ("pt1: port went away", "pt2: link lost (no answer)", "d1: link closed (still opening)"):
        assert words in str(answer["error"])


def test_a_head_with_a_lost_link_is_resumed_for_later() -> None:
    desk = Desk()
    desk.link("pt2", LinkStatus.LOST, "no answer")
    answer = desk.operator().handle({"command": "resume"}, ME)
    assert answer["unreached"] == {"pt2": "link lost (no answer)"}
    assert desk.done == [("resume", ("pt1", "pt2"))]


@pytest.mark.parametrize("command", ["arm", "land"])
def test_a_drone_out_of_reach_is_given_no_order_that_it_might_obey_later(command: str) -> None:
    desk = Desk()
    desk.link("d1", LinkStatus.LOST, "no heartbeat")
    answer = desk.operator().handle({"command": command, "drone": "d1"}, ME)
    assert answer == {"ok": False, "error": "drone d1 cannot be reached: link lost (no heartbeat)", "exit_code": 3}
    assert desk.done == []


@pytest.mark.parametrize(
    ("does", "health"),
    [
        (FlightState.FLYING, DroneHealth("flying", obeys=True)),
        (FlightState.GROUND, DroneHealth("arming", obeys=False, begins=True)),
    ],
)
def test_no_drone_takes_off_beside_one_that_flies_or_is_about_to(does: FlightState, health: DroneHealth) -> None:
    desk = Desk(health={"d2": health})
    second = replace(desk.rig.drones["d1"], id="d2")
    desk.rig = replace(desk.rig, drones={**desk.rig.drones, "d2": second})
    desk.link("d2", LinkStatus.UP)
    for name, x_m, flight in (("d1", 1.0, FlightState.GROUND), ("d2", 2.0, does)):
        T = transform(np.eye(3), np.array([x_m, 1.0, 1.5]))
        histories = desk.state.histories.with_reading(DroneReading(name, 0.0, T, np.eye(6), flight))
        desk.state = replace(desk.state, histories=histories, flight={**desk.state.flight, name: flight})
    answer = desk.operator().handle({"command": "arm", "drone": "d1"}, ME)
    assert "drone d1 is not armed: drone d2 flies 1.00 m beside it" in str(answer["error"])
    assert (answer["exit_code"], desk.done) == (3, [])


def test_drones_are_resumed_by_name_and_reached_first() -> None:
    desk = Desk()
    operator = desk.operator()
    answer = operator.handle({"command": "resume", "drones": ["d1"]}, ME)
    assert (answer["heads"], answer["drones"], desk.done) == ([], ["d1"], [("resume", ("d1",))])
    assert "its drones are d1" in str(operator.handle({"command": "resume", "drones": ["pt1"]}, ME)["error"])
    desk.link("d1", LinkStatus.LOST, "no heartbeat")
    assert "drone d1 cannot be reached" in str(operator.handle({"command": "resume", "drones": ["d1"]}, ME)["error"])


def test_a_rig_without_heads_has_nothing_to_resume() -> None:
    bare = rig()
    desk = Desk(rig=Rig(bare.name, bare.space, bare.cameras))
    answer = desk.operator().handle({"command": "resume"}, ME)
    assert (answer["exit_code"], desk.done) == (2, [])
    assert "has no heads" in str(answer["error"])
    assert "it has no drones" in str(desk.operator().handle({"command": "arm", "drone": "d1"}, ME)["error"])


def test_every_order_is_logged_with_its_sender_and_its_result(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    operator = Desk().operator()
    operator.handle({"command": "hold"}, ME)
    operator.handle({"command": "arm", "drone": "d\n9"}, "http 10.0.0.3")
    operator.handle({"command": "status"}, ME)
    held, refused = (record.getMessage() for record in caplog.records)
    assert held == 'operator: uid 7 pid 8: {"command":"hold"}: done'
    assert refused.startswith('operator: http 10.0.0.3: {"command":"arm","drone":"d\\n9"}: rig')
    assert "\n" not in refused


def test_status_says_what_is_known_and_null_where_nothing_is() -> None:
    desk = Desk(
        targets=(
            target("robot1", TargetStatus.TRACKED, 9.5),
            target("robot2", TargetStatus.UNSEEN, float("-inf")),
            target("robot3", TargetStatus.LOST, 4.0, variance_m2=float("inf")),
        ),
        now_s=10.0,
    )
    desk.link("pt2", LinkStatus.LOST, "no answer")
    status = desk.operator().handle({"command": "status"}, ME)
    assert json.loads(json.dumps(status, allow_nan=False)) == status
    assert (status["ok"], status["rig"], status["phase"], status["plan"]) == (True, "lab", "scanning", None)
    assert status["targets"] == {
        "robot1": {
            "status": "tracked",
            "position_m": [1.0, 2.0, 0.0],
            "sigma_m": [0.02, 0.02, 0.02],
            "planned_sigma_m": None,
            "innovation": None,
            "seen_by": ["north"],
            "age_s": 0.5,
        },
        "robot2": {
            "status": "unseen",
            "position_m": None,
            "sigma_m": None,
            "planned_sigma_m": None,
            "innovation": None,
            "seen_by": ["north"],
            "age_s": None,
        },
        "robot3": {
            "status": "lost",
            "position_m": [1.0, 2.0, 0.0],
            "sigma_m": [None, None, None],
            "planned_sigma_m": None,
            "innovation": None,
            "seen_by": ["north"],
            "age_s": 6.0,
        },
    }
    pt1 = {"link": "up", "reason": "", "enabled": True, "control": "planner", "pan_deg": None, "tilt_deg": None}
    pt2 = {"link": "lost", "reason": "no answer", "enabled": False, "control": "held", "pan_deg": None, "aim": None}
    assert part(status, "heads", "pt1").items() >= pt1.items()
    assert part(status, "heads", "pt2").items() >= pt2.items()
    assert part(status, "heads", "pt1")["limits"] == {"pan_deg": [-171.887, 171.887], "tilt_deg": [-85.944, 0.0]}
    assert part(status, "drones", "d1").items() >= {"link": "up", "reason": "", "flight": "unknown"}.items()


def test_status_tells_the_plan_and_the_flight() -> None:
    plan = RigPlan(3, 8.0, PlanStatus.PARTIAL, 0.01, {}, {}, ("robot2",), 0.05, {"robot3": "north"})
    state = begin(0.0)
    mission = replace(state.mission, scanning=False, plan=plan)
    desk = Desk(state=replace(state, mission=mission, flight={"d1": FlightState.FLYING}), now_s=10.0)
    status = desk.operator().handle({"command": "status"}, ME)
    assert status["phase"] == "tracking"
    assert part(status, "drones", "d1")["flight"] == "flying"
    assert status["plan"] == {
        "status": "partial",
        "uncovered": ["robot2"],
        "searching": {"robot3": "north"},
        "objective_m": 0.01,
        "solve_s": 0.05,
        "age_s": 2.0,
    }


def test_status_tells_what_was_learnt_of_a_lens() -> None:
    known = Refined(np.array([0.000462, -0.39, 0.21, -0.00031]), np.eye(4))
    desk = Desk(state=replace(begin(0.0), lenses=Lenses(refined={"north": known})))
    status = desk.operator().handle({"command": "status"}, ME)
    learnt = {"f_percent": 0.0462, "centre_px": [-0.39, 0.21], "k1": -0.00031, "bounded": False}
    assert part(status, "cameras", "north")["lens_refined"] == learnt


def test_status_tells_where_a_head_points_who_controls_it_and_how_its_link_does() -> None:
    desk = Desk(aimed={"pt2": HeadAim(0.5, -0.5)}, enabled=frozenset({"pt1", "pt2"}), now_s=10.0)
    desk.points("pt1", math.radians(12.0), math.radians(-30.0))
    desk.statistics = {"pt1": {"losses": 2, "polls": 100, "answers": 99, "reply_s": math.nan}}
    status = desk.operator().handle({"command": "status"}, ME)
    pt1 = part(status, "heads", "pt1")
    assert (pt1["pan_deg"], pt1["tilt_deg"], pt1["sigma_deg"]) == (12.0, -30.0, [0.057, 0.057])
    assert pt1["statistics"] == {"losses": 2, "polls": 100, "answers": 99, "reply_s": None}
    assert pt1["since_s"] == 10.0
    pt2 = part(status, "heads", "pt2")
    assert (pt2["control"], pt2["aim"]) == ("operator", {"pan_deg": 28.648, "tilt_deg": -28.648})


class TestAim:
    """An operator sends a head somewhere."""

    def test_both_axes(self) -> None:
        desk = Desk()
        request = {"command": "aim", "head": "pt2", "pan_deg": 10, "tilt_deg": -20}
        answer = desk.operator().handle(request, ME)
        assert answer == {"ok": True, "head": "pt2", "pan_deg": pytest.approx(10.0), "tilt_deg": pytest.approx(-20.0)}
        assert desk.aimed["pt2"] == HeadAim(math.radians(10.0), math.radians(-20.0))

    def test_an_axis_that_is_not_named_stays(self) -> None:
        desk = Desk()
        desk.points("pt1", 0.3, -0.7)
        answer = desk.operator().handle({"command": "aim", "head": "pt1", "pan_deg": 10}, ME)
        assert answer["tilt_deg"] == pytest.approx(math.degrees(-0.7))
        desk.points("pt1", 0.1, -0.6)  # on the way
        answer = desk.operator().handle({"command": "aim", "head": "pt1", "tilt_deg": -10}, ME)
        assert answer["pan_deg"] == pytest.approx(10.0)

    def test_where_it_points_must_be_known_for_that(self) -> None:
        desk = Desk()
        answer = desk.operator().handle({"command": "aim", "head": "pt1", "pan_deg": 10}, ME)
        assert (answer["exit_code"], desk.done) == (3, [])
        assert "not known where head pt1 points now: give both" in str(answer["error"])

    def test_a_head_out_of_reach_is_given_no_order_that_it_might_obey_later(self) -> None:
        desk = Desk()
        desk.link("pt1", LinkStatus.LOST, "no answer")
        answer = desk.operator().handle({"command": "aim", "head": "pt1", "pan_deg": 1, "tilt_deg": -1}, ME)
        assert answer == {"ok": False, "error": "head pt1 cannot be reached: link lost (no answer)", "exit_code": 3}
        assert desk.done == []


def part(answer: Mapping[str, object], *keys: str) -> dict[str, object]:
    """Return an object within an answer."""
    found: object = answer
    for key in keys:
        assert isinstance(found, dict)
        found = found[key]
    assert isinstance(found, dict)
    return found


def test_frame_rates_are_those_of_the_last_seconds() -> None:
    desk = Desk()
    operator = desk.operator()

    def fps() -> object:
        cameras = operator.handle({"command": "status"}, ME)["cameras"]
        assert isinstance(cameras, dict)
        return {name: camera["fps"] for name, camera in cameras.items()}

    assert fps() == {"north": None, "sky": None}
    for tick in range(21):  # ten seconds: north at 8 frames a second, sky at 4 until it dies after 5 s
        desk.now_s, desk.delivered = 0.5 * tick, {"north": 4 * tick, "sky": 2 * min(tick, 10)}
        operator.watch()
        if tick == 10:
            assert fps() == {"north": 8.0, "sky": 4.0}
    assert fps() == {"north": 8.0, "sky": 0.0}


def test_the_newest_events_are_kept() -> None:
    desk = Desk(now_s=100.0)
    for number in range(50):
        desk.arming = refusal(float(number), f"reason {number}")
        desk.arm("d1")
    events = desk.operator().handle({"command": "status"}, ME)["events"]
    assert isinstance(events, list)
    assert len(events) == EVENTS_KEPT
    assert events[-1] == {"about": "d1", "level": "warning", "text": "reason 49", "age_s": 51.0}


def test_the_sink_of_events_needs_no_output() -> None:
    sink = RecentEvents()
    sink.open(rig())
    sink.close()
    assert sink.latest == ()


def test_a_lent_head_is_neither_aimed_nor_resumed() -> None:
    desk = Desk()
    operator = desk.operator()
    desk.lent = frozenset({"pt1", "north"})
    for order in ({"command": "aim", "head": "pt1", "pan_deg": 1.0}, {"command": "resume", "heads": ["pt1"]}):
        answer = operator.handle(order, ME)
        assert answer["exit_code"] == 3
        assert "head pt1 is lent to another program" in str(answer["error"])
    assert desk.done == []
    assert operator.handle({"command": "resume"}, ME)["heads"] == ["pt2"]
