"""The command plan: exit codes, JSON, and messages on stderr."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import yaml

import hyperbit as hb
from hyperbit.controller.commands.study.plan_rows import sentence
from hyperbit.controller.motion.plans import whole

ARM = str(Path(__file__).parents[3] / "deploy" / "planar16.yaml")

pytestmark = pytest.mark.usefixtures("own_folders")


def test_plan_prints_one_line_of_json(hyperbit):
    code, out, _ = hyperbit("plan", ARM, "--goal", "0.55,2.9", "--json")
    [line] = [json.loads(text) for text in out.splitlines()]
    assert code == 0
    assert list(line) == [
        *("goal", "configuration", "position", "orientation"),
        *("error", "orientation_error", "switches", "seconds", "cost", "optimal", "lower_bound"),
        *("certificate", "within_tolerance"),
    ]
    assert line["goal"] == [0.55, 2.9]
    assert line["orientation_error"] is None
    assert line["lower_bound"] <= line["switches"]
    assert line["optimal"] is (line["lower_bound"] >= line["switches"])
    assert line["within_tolerance"] is True
    assert line["error"] == pytest.approx(math.dist(line["position"], line["goal"]))
    assert line["switches"] == sum(bin(int(digit)).count("1") for digit in line["configuration"])


def test_plan_does_not_switch_an_actuator_that_is_declared_stuck(hyperbit, tmp_path):
    document = yaml.safe_load(Path(ARM).read_text())
    for label in ("left", "right"):
        next(a for a in document["actuators"] if (a["module"], a["actuator"]) == (3, label))["stuck"] = "extended"
    file = tmp_path / "stuck.yaml"
    file.write_text(yaml.safe_dump(document))
    for goal in ("0.55,2.9", "-0.4,2.9"):
        code, out, _ = hyperbit("plan", str(file), "--goal", goal, "--json")
        line = json.loads(out)
        found = json.loads(hyperbit("fk", ARM, line["configuration"], "--json")[1])
        assert (code, int(line["configuration"][2]) & 0b101) == (0, 0b101)
        assert found["position"] == pytest.approx(line["position"])
    code, _, err = hyperbit("plan", str(file), "--goal", "0.55,2.9", "--previous", "0" * 16)
    assert code == 2
    assert "--previous: 0000000000000000: as actuators are locked, module 3 has no state" in err


@pytest.mark.parametrize(
    "method",
    ["minimum-switch", "pop", "ipop-previous", "ipop-contracted", "ipop-fewest-switches", "ipop-fewest-extended"],
)
def test_plan_takes_method_tolerance_and_previous(hyperbit, method):
    words = (
        "--goal",
        "-1.0,2.2",
        "--method",
        method,
        "--tolerance",
        "0.004",
        "--previous",
        "0123456701234567",
        "--json",
    )
    code, out, _ = hyperbit("plan", ARM, *words)
    assert code == 0
    assert json.loads(out)["error"] <= 0.004


def test_goals_of_a_file_start_at_the_previous_goal_by_default(hyperbit, tmp_path):
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y,previous\n0.55,2.9,\n0.55,2.9,\n0.55,2.9,0000000000000000\n")
    code, out, _ = hyperbit("plan", ARM, "--goals", str(goals), "--json")
    first, second, third = (json.loads(text) for text in out.splitlines())
    assert code == 0
    assert second["switches"] == 0
    assert second["configuration"] == first["configuration"]
    assert third["switches"] == first["switches"] > 0


def test_goals_of_a_file_are_planned_as_the_library_plans_a_path(hyperbit, tmp_path, monkeypatch):
    monkeypatch.setattr(whole, "WHOLE_TIME", 60.0)  # so that both prove the minimum of switches on any machine
    file = tmp_path / "short.yaml"
    file.write_text(
        "name: short\ntolerance: {position: 0.01}\nmodules: [{type: vgt, count: 4, width: 0.2, lengths: [0.2, 0.25]}]\n"
    )
    arm = hb.load(file)
    rows = arm.sample(3, seed=2)
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in arm.frames(rows)[:, :2, 3].tolist()))
    lines = [json.loads(text) for text in hyperbit("plan", str(file), "--goals", str(goals), "--json")[1].splitlines()]
    path = hb.Solver(arm).follow(list(arm.frames(rows)[:, :2, 3]))
    proven = {"switches": path.switches, "cost": path.cost, "optimal": True}
    proven |= {"lower_bound": path.lower_bound, "certificate": "optimal", "gap": 0.0}
    assert [line["trajectory"] for line in lines] == [proven] * 3
    assert sum(line["switches"] for line in lines) == path.switches == path.lower_bound
    words = hyperbit("plan", str(file), "--goals", str(goals), "--prove", "--deadline", "60")[1]
    assert f"{path.switches} switches in all; proven to be the fewest" in words


@pytest.mark.parametrize("given", [("--goal", "0.55,2.9"), ("--goals", "goals.csv", "--apart")])
def test_only_trajectories_are_proven_as_a_whole(hyperbit, given):
    code, _, err = hyperbit("plan", ARM, *given, "--prove")
    assert code != 0
    assert "it is for a trajectory: give --goals FILE.csv, without --apart" in err


@pytest.mark.parametrize(
    ("cost", "certificate", "words"),
    [
        (9.0, "optimal", "9 switches in all; proven to be the fewest"),
        (9.0, "bound", "9 switches in all; proven: at least 7"),
        (12.5, "optimal", "9 switches of cost 12.5 in all; proven to cost least"),
        (12.5, "bound", "9 switches of cost 12.5 in all; proven: a cost of at least 7"),
        (12.5, "unknown", "9 switches of cost 12.5 in all; nothing is proven"),
    ],
)
def test_a_bound_is_of_the_number_beside_it(cost, certificate, words):
    assert sentence({"switches": 9, "cost": cost, "lower_bound": 7.0, "certificate": certificate}) == words


def test_a_goal_out_of_reach_fails_but_a_list_of_goals_is_reported(hyperbit, tmp_path):
    code, out, err = hyperbit("plan", ARM, "--goal", "9,9", "--json")
    assert code == 1
    assert json.loads(out)["within_tolerance"] is False
    assert "nearest" in err
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y\n9,9\n0.5,2.5\n")
    code, out, err = hyperbit("plan", ARM, "--goals", str(goals), "--json")
    assert code == 0
    assert [json.loads(text)["within_tolerance"] for text in out.splitlines()] == [False, True]
    assert "no plan of the whole trajectory: waypoints[0]" in err


def test_plan_takes_an_angle_and_its_tolerance(hyperbit, tmp_path):
    words = ("--goal", "0.55,2.9,0.3", "--turn", "0.02", "--tolerance", "0.005")
    code, out, _ = hyperbit("plan", ARM, *words, "--json")
    line = json.loads(out)
    assert code == 0
    assert line["goal"] == [0.55, 2.9]
    assert line["orientation_error"] == pytest.approx(abs(line["orientation"] - 0.3))
    assert line["orientation_error"] <= 0.02
    code, _, err = hyperbit("plan", ARM, "--goal", "0.55,2.9,3.0")
    assert code == 1
    assert "and turned" in err
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y,th\n0.55,2.9,0.3\n0.55,2.9,\n")
    code, out, _ = hyperbit("plan", ARM, "--goals", str(goals), "--json")
    assert code == 0
    assert [json.loads(text)["orientation_error"] is None for text in out.splitlines()] == [False, True]
    code, _, err = hyperbit("plan", ARM, "--goals", str(goals), "--path-tolerance", "0.05")
    assert code == 2
    assert "lines are followed by position only" in err


def test_plan_takes_a_quaternion(hyperbit, spatial):
    code, out, _ = hyperbit("fk", spatial, "012012", "--json")
    tip = json.loads(out)
    goal = ",".join(f"{x:.6f}" for x in [*tip["position"], *tip["orientation"]])
    code, out, _ = hyperbit("plan", spatial, "--goal", goal, "--tolerance", "0.0001", "--json")
    assert code == 0
    assert json.loads(out)["orientation_error"] <= 0.05
    code, _, err = hyperbit("plan", spatial, "--goal", "0,0,0.5,1,1,0,0")
    assert code == 2
    assert "of length 1 is needed, got one of length 1.414" in err


def test_goals_of_a_file_are_followed_along_lines(hyperbit, tmp_path):
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y\n0.55,2.9\n0.55,2.8\n0.4,2.8\n")
    words = ("plan", ARM, "--goals", str(goals), "--path-tolerance", "0.05")
    code, out, _ = hyperbit(*words, "--json")
    lines = [json.loads(text) for text in out.splitlines()]
    assert code == 0
    assert [line["between"] for line in lines] == [False, *[True] * 7, False, *[True] * 11, False]
    assert [line["goal"] for line in lines if not line["between"]] == [[0.55, 2.9], [0.55, 2.8], [0.4, 2.8]]
    assert all(line["within_tolerance"] and line["error"] < 0.05 for line in lines)
    assert sum(line["switches"] > 0 for line in lines) < len(lines) / 2
    assert hyperbit(*words)[1].count("\n  0.") == 18
    goals.write_text("x,y\n-2.6,1.5\n2.6,1.5\n")
    code, out, err = hyperbit(*words, "--json")
    assert (code, out) == (1, "")
    assert "waypoints[0] to waypoints[1]: (" in err
    goals.write_text("x,y,previous\n0.5,2.9,\n0.5,2.8,0000000000000000\n")
    code, out, err = hyperbit(*words)
    assert (code, out) == (2, "")
    assert "column previous" in err


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--goal", "1,2", "--path-tolerance", "0.1"),
        ("--goals", "x.csv", "--path-tolerance", "0"),
        ("--goals", "x.csv", "--path-tolerance", "nan"),
        ("--goal", "1"),
        ("--goal", "1,nan"),
        ("--goal", "a,b"),
        ("--goal", "1,2,3,4"),
        ("--goal", "1,2,3", "--turn", "0"),
        ("--goal", "1,2", "--tolerance", "0"),
        ("--goal", "1,2", "--deadline", "0"),
        ("--goal", "1,2", "--deadline", "nan"),
        ("--goal", "1,2", "--tolerance", "nan"),
        ("--goal", "1,2", "--method", "guess"),
        ("--goal", "1,2", "--previous", "1"),
        ("--goal", "1,2", "--goals", "x.csv"),
        ("--goals", "no-such-file.csv"),
    ],
)
def test_unusable_words_of_plan_end_with_2(hyperbit, words):
    code, out, err = hyperbit("plan", ARM, *words)
    assert code == 2
    assert out == ""
    assert err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "columns"),
        ("a,b\n1,2\n", "columns x,y"),
        ("x,y\n", "no goals"),
        ("x,y\n1,2\n1,inf\n3\n", "line 3"),
        ("x,y,previous\n1,2,99\n", "line 2"),
    ],
)
def test_every_unusable_line_of_a_goals_file_is_named(hyperbit, tmp_path, text, says):
    goals = tmp_path / "goals.csv"
    goals.write_text(text)
    code, out, err = hyperbit("plan", ARM, "--goals", str(goals))
    assert (code, out) == (2, "")
    assert says in err
