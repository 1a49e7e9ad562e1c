"""Goals from the network: which are accepted, and code and message of each refusal."""

import json
import math
import re
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.motion.decoding import goal as module
from hyperbit.controller.motion.decoding.goal import (
    GoalRules,
    check_reach,
    parse,
    parse_quickly,
    parse_strictly,
    schedule,
)
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import MOST_POINTS, Trajectory
from hyperbit.controller.refusals.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP
from hyperbit.controller.refusals.refusal import Refusal
from tests.motion.decoding.requests import json_values

NOW = 1_800_000_000.0


def decode(payload: bytes, dimension: int = 2) -> Trajectory:
    return schedule(parse(payload), GoalRules(dimension, 0.002, 0.05, Pace(0.06)), NOW)


def goal(**fields: Any) -> bytes:
    return json.dumps({"waypoints": [{"position": [0.5, 2.9]}], **fields}).encode()


def timed(*times: float, **fields: Any) -> bytes:
    return goal(waypoints=[{"t": t, "position": [0.5, 2.9]} for t in times], **fields)


def one(**fields: Any) -> bytes:
    return goal(waypoints=[{"position": [0.5, 2.9], **fields}])


def line(seconds: float, path_tolerance: float = 0.01) -> bytes:
    ends = [{"position": [0.0, 2.9]}, {"t": seconds, "position": [1.0, 2.9]}]
    return goal(waypoints=ends, path_tolerance=path_tolerance)


def raw(position: bytes) -> bytes:
    return b'{"waypoints": [{"position": [1, %s]}]}' % position


REFUSED = {
    "no waypoints": (b"{}", "waypoints: required, but missing"),
    "empty waypoints": (goal(waypoints=[]), "waypoints: empty; at least one is needed"),
    "waypoints no list": (goal(waypoints={}), "waypoints: Expected `array`"),
    "waypoint no object": (goal(waypoints=[1]), r"waypoint 1: Expected `object`"),
    "no position": (goal(waypoints=[{"t": 1}]), r"waypoint 1, position: required, but missing"),
    "unknown field": (goal(velocity=1), "velocity: unknown field; known are begin_within, deadline, id, path"),
    "no time to plan": (goal(deadline=0), r"deadline: Expected `float` > 0\.0"),
    "more than a minute to plan": (goal(deadline=60.1), r"deadline: Expected `float` <= 60\.0"),
    "unknown in a waypoint": (one(velocity=1), r"waypoint 1, velocity: unknown field; known are configuration"),
    "unknown in the tolerance": (goal(tolerance={"angle": 1}), r"tolerance\.angle: unknown field; known are"),
    "three unknown": (goal(a=1, b=1, c=1, d=1, e=1), r"a: unknown.*; b: unknown.*; c: unknown.*\(and 2 more faults\)"),
    "long field": (goal(**{"x" * 100_000: 1}), r"^x{997}\.\.\.$"),
    "field twice": (b'{"id": "a", "waypoints": [], "id": "b"}', "goal is not JSON: 'id' occurs twice in one object"),
    "text for a number": (one(t="1"), r"waypoint 1, t: Expected `float`, got `str` \(given: '1'\)"),
    "truth for a number": (one(t=True), r"waypoint 1, t: Expected `float`, got `bool`"),
    "null for a number": (one(t=None), r"waypoint 1, t: Expected `float`, got `null`"),
    "number for an id": (goal(id=1), "id: Expected `str \\| null`, got `int`"),
    "empty id": (goal(id=""), "id: "),
    "line break in the id": (goal(id="a\nMAINPID=1"), "id: "),
    "half a surrogate pair in the id": (b'{"waypoints": [{"position": [1, 2]}], "id": "\\udc80"}', "id: "),
    "half a surrogate pair within a number": (raw(b'"\\ud800"'), r"position\[1\]: a lone surrogate is no text"),
    "long id": (goal(id="x" * 129), "id: "),
    "negative time": (one(t=-1), r"waypoint 1, t: Expected `float` >= 0"),
    "negative stamp": (goal(stamp=-1), "stamp: Expected `float` >= 0"),
    "no tolerance": (goal(tolerance={"position": 0}), r"tolerance\.position: Expected"),
    "tolerance beyond all": (goal(tolerance={"position": 1e200}), r"tolerance\.position: Expected"),
    "no path tolerance": (goal(path_tolerance=0), r"^path_tolerance: Expected"),
    "negative path tolerance": (goal(path_tolerance=-1), r"^path_tolerance: Expected"),
    "path tolerance as text": (goal(path_tolerance="1"), r"^path_tolerance: Expected `float \| null`, got `str`"),
    "path tolerance in the tolerance": (goal(tolerance={"path_tolerance": 1}), r"tolerance\.path_tolerance: unknown"),
    "line too fast": (line(0.06), r"waypoint 1 to 2: 0\.06 s for a line of 1 within path"),
    "line too long": (line(9e3, 1e-8), r"path_tolerance: 1e-08 takes 2e\+08 points along lines of 1"),
    "NaN": (raw(b"NaN"), r"waypoint 1, position\[1\]: nan is not a finite number"),
    "Infinity": (raw(b"-Infinity"), r"waypoint 1, position\[1\]: -inf is not a finite number"),
    "1e999": (raw(b"1e999"), r"waypoint 1, position\[1\]: inf is not a finite number"),
    "NaN as time": (b'{"waypoints": [{"position": [1, 2], "t": NaN}]}', r"waypoint 1, t: nan is not a finite"),
    "infinite stamp": (b'{"waypoints": [{"position": [1, 2]}], "stamp": 1e999}', "stamp: inf is not a finite number"),
    "NaN as tolerance": (b'{"waypoints": [], "tolerance": {"position": NaN}}', r"tolerance\.position: nan is not"),
    "far away": (raw(b"1e300"), r"waypoint 1, position\[1\]: Expected `float` <= 1000000"),
    "huge integer": (raw(b"1" + b"0" * 400), r"waypoint 1, position\[1\]: Number out of range"),
    "one coordinate": (one(position=[1]), r"waypoint 1, position: Expected `array` of length >= 2"),
    "four coordinates": (one(position=[1, 2, 3, 4]), r"waypoint 1, position: Expected `array` of length <= 3"),
    "spatial": (one(position=[1, 2, 3]), r"waypoint 1, position: 3 coordinates, this arm's positions have 2"),
    "quaternion in the plane": (one(orientation=[0, 0, 0, 1]), r"1, orientation: a planar arm's orientation is an"),
    "text for an orientation": (one(orientation="up"), r"waypoint 1, orientation: Expected `float \| array \| null`"),
    "orientation beyond all bounds": (one(orientation=1e9), r"Expected `float` <= 12.5664 .*; in radians$"),
    "orientation in degrees": (one(orientation=-50), r"orientation: .* in radians, -50 degrees are -0\.8727$"),
    "orientation along lines": (
        goal(waypoints=[{"position": [0.5, 2.9], "orientation": 0.1}], path_tolerance=0.1),
        r"waypoint 1, orientation: lines are followed by position only, leave out path_tolerance",
    ),
    "same time": (timed(1, 1), r"waypoint 2, t: 1 does not come after 1 of waypoint 1"),
    "back in time": (timed(0, 1, 0.5), r"waypoint 3, t: 0\.5 does not come after 1 of waypoint 2"),
    "too fast": (timed(0, 1, 1.05), r"waypoint 2 to 3: 0\.05 s apart, the actuators need 0\.06 s"),
    "stamp in milliseconds": (goal(stamp=NOW * 1000), r"stamp: the trajectory would end 1\.8e\+12 s from now, at most"),
    "end in two days": (timed(0, 172_800), "stamp: the trajectory would end 1.73e\\+05 s from now, at most 86400 s"),
    "many waypoints": (b'{"waypoints": [%s1]}' % (b"1," * 99_999), f"waypoints: 100000, at most {MOST_POINTS} are"),
}  # fmt: skip


@pytest.mark.parametrize(("payload", "sentence"), REFUSED.values(), ids=REFUSED.keys())
def test_refused_as_invalid_with_a_sentence(payload: bytes, sentence: str) -> None:
    with pytest.raises(Refusal) as caught:
        decode(payload)
    assert caught.value.code == INVALID_GOAL
    assert re.search(sentence, str(caught.value)), str(caught.value)


def test_an_end_in_the_past_is_refused_with_how_long_ago() -> None:
    with pytest.raises(Refusal, match=r"stamp: the trajectory ended 2\.500 s before it arrived") as caught:
        decode(timed(0, 1, stamp=NOW - 3.5))
    assert caught.value.code == OLD_HEADER_TIMESTAMP


@pytest.mark.parametrize("stamp", [{}, {"stamp": 0}, {"stamp": 0.0}])
def test_without_a_stamp_it_begins_when_it_is_taken(stamp: dict[str, float]) -> None:
    trajectory = decode(timed(0, 0.06, 2, **stamp))
    assert trajectory.stamp is None
    assert trajectory.times.tolist() == [0, 0.06, 2]
    assert trajectory.positions.tolist() == [[0.5, 2.9]] * 3
    assert trajectory.tolerances.tolist() == [0.002] * 3


def test_stamp_id_and_tolerance_are_taken_over() -> None:
    payload = timed(0, 5, stamp=NOW - 3, id="a b/c-1", tolerance={"position": 0.01})
    assert parse(payload).id == "a b/c-1"
    trajectory = decode(payload)
    assert (trajectory.stamp, trajectory.tolerances.tolist()) == (NOW - 3, [0.01, 0.01])
    assert decode(goal(tolerance={})).tolerances.tolist() == [0.002]


def test_with_a_path_tolerance_there_are_points_between() -> None:
    trajectory = decode(line(60.0))
    assert trajectory.path_tolerance == 0.01
    assert (len(trajectory.times), trajectory.waypoints.tolist()) == (401, [0, 400])
    assert decode(goal(path_tolerance=0.01)).waypoints.tolist() == [0]
    assert decode(goal(path_tolerance=None)).path_tolerance is None


def test_the_most_waypoints_are_taken() -> None:
    assert len(decode(timed(*[0.1 * k for k in range(MOST_POINTS)])).times) == MOST_POINTS


def turned(orientation: Any, **fields: Any) -> bytes:
    return goal(waypoints=[{"position": [0.5, 2.9, 1.0], "orientation": orientation}], **fields)


def test_an_orientation_is_taken_with_its_tolerance_where_it_is_given():
    ends = [{"position": [0.5, 2.9]}, {"t": 1.0, "position": [0.5, 2.9], "orientation": math.pi / 2}]
    own, given = decode(goal(waypoints=ends)), decode(goal(waypoints=ends, tolerance={"orientation": 0.2}))
    assert own.turns.tolist() == [math.inf, 0.05]
    assert given.turns.tolist() == [math.inf, 0.2]
    assert own.goal(0).tolist() == [0.5, 2.9]
    assert_allclose(own.goal(1), frames.planar(0.5, 2.9, math.pi / 2))


def test_an_orientation_with_a_tolerance_of_half_a_turn_is_none():
    found = decode(one(orientation=1.0)[:-1] + b', "tolerance": {"orientation": 3.2}}')
    assert found.turns.tolist() == [math.inf]


def test_a_quaternion_is_taken_as_x_y_z_w_and_made_a_unit_one():
    found = decode(turned([0.0, 0.0, 0.7071, 0.7071]), dimension=3)
    assert_allclose(found.goal(0), frames.spatial((0.5, 2.9, 1.0), (0, 0, 1, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("orientation", "got"),
    [(0.5, "0.5"), ([1, 1, 0, 0], "one of length 1.414"), ([0, 0, 1], r"\[0"), ([0] * 4, r"\[0")],
)
def test_what_is_no_unit_quaternion_is_refused(orientation, got):
    with pytest.raises(Refusal, match=rf"waypoint 1, orientation: a quaternion x, y, z, w of length 1 .*got {got}"):
        decode(turned(orientation), dimension=3)


numbers = st.floats() | st.integers() | json_values
waypoints = st.lists(
    st.fixed_dictionaries(
        {"position": st.lists(numbers, max_size=4) | json_values}, optional={"t": numbers, "orientation": numbers}
    ),
    max_size=4,
)
goals = st.fixed_dictionaries(
    {"waypoints": waypoints | json_values},
    optional={
        "id": json_values,
        "stamp": numbers,
        "tolerance": st.dictionaries(st.sampled_from(["position", "orientation"]), numbers),
        "path_tolerance": numbers,
    },
)


@given(goals.map(lambda value: json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogatepass")) | st.binary())
@example(b'{"waypoints": [{"configuration": "a\tb"}]}')
@example(b'{"waypoints": [{"position": [1, 2]}], "id": "t"}')
@example(b'\xef\xbb\xbf{"waypoints": [{"position": [1, 2]}]}')
def test_what_is_read_quickly_is_what_is_read_strictly(payload: bytes) -> None:
    if (message := parse_quickly(payload)) is not None:
        assert message == parse_strictly(payload)


def test_names_that_stand_twice_are_not_read_quickly() -> None:
    assert parse_quickly(b'{"waypoints": [{"position": [1, 2]}]}') is not None
    for twice in (b'{"waypoints": [], "waypoints": []}', b'{"waypoints": [], "\\u0077aypoints": []}'):
        assert parse_quickly(twice) is None


@pytest.mark.parametrize("payload", [b"{", b"\xff", b'{"waypoints": [{"position": [NaN, 1]}]}', b'{"id": "\\ud800"}'])
def test_the_reason_of_a_refusal_is_not_looked_for_until_it_is_read(
    payload: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    sought: list[bytes] = []
    monkeypatch.setattr(module, "parse_strictly", lambda payload: sought.append(payload) or parse_strictly(payload))
    with pytest.raises(Refusal) as refused:
        parse(payload)
    assert sought == []
    assert str(refused.value)
    assert sought == [payload]


@pytest.mark.parametrize("name", ["tolerance.position", "path_tolerance"])
def test_a_tolerance_that_every_tip_keeps_is_refused(name: str) -> None:
    wrong = {"tolerance": {"position": 9}} if name == "tolerance.position" else {"path_tolerance": 9}
    with pytest.raises(Refusal, match=f"{name}: 9, but all tips are within 8 of each other; check its unit"):
        check_reach(parse(goal(waypoints=[{"position": [1, 2]}], **wrong)), (0.0, 0.0), 4.0, 0.002)
