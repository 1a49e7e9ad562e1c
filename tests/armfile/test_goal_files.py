"""Goals in CSV, JSON and YAML are one payload."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.armfile.goal_files import parse_goal_file, read_goal
from hyperbit.controller.armfile.strict import InputFaults

coordinates = st.floats(-1e6, 1e6, allow_subnormal=False)
waypoints = st.builds(
    lambda position, turn: {"position": position, **({} if turn is None else {"orientation": turn})},
    st.lists(coordinates, min_size=2, max_size=2),
    st.none() | st.floats(-math.pi, math.pi),
)


@given(st.lists(waypoints, min_size=1, max_size=5), st.booleans())
def test_each_format_gives_the_same_goal(points, timed):
    given = [{**point, **({"t": 0.5 * k} if timed else {})} for k, point in enumerate(points)]
    rows = [[*point["position"], point.get("orientation", ""), point.get("t", "")] for point in given]
    text = "\ufeffx,y,th,t\r\n" + "".join(",".join(map(str, row)) + "\r\n" for row in rows)
    goal = {"waypoints": given}
    assert parse_goal_file(text, Path("a.csv")) == goal
    for name, other in (("a.json", json.dumps(goal)), ("a.yml", yaml.safe_dump(goal))):
        assert parse_goal_file(other, Path(name)) == goal


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y,t\n1,2,0\n1,2,1\n1,2,\n", "a.csv: line 4: no t: give a time [s] to each row, or to none"),
        ("x,y,t\n1,2,0\n1,2,-1\n1,x,1\n", "a.csv: line 3: t [s]: "),
        ("x,y,previous\n1,2,00\n", "a.csv: column previous: it is for studies"),
        ("x,y,v\n1,2,3\n", "a.csv: columns x,y are needed, th, t and previous are optional; got"),
        ("x,y\n", "a.csv: no goals"),
        ("x,y,z,t\n1,2,3,0\n", None),
    ],
)
def test_a_row_that_is_no_waypoint_is_named(tmp_path, text, told):
    path = tmp_path / "a.csv"
    path.write_text(text)
    if told is None:
        assert read_goal(path) == {"waypoints": [{"position": [1.0, 2.0, 3.0], "t": 0.0}]}
        return
    with pytest.raises(InputFaults, match="^" + str(tmp_path)) as caught:
        read_goal(path)
    assert told in str(caught.value)
