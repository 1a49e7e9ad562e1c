"""The command line as scripts see it: exit codes, JSON, and words on stderr."""

from __future__ import annotations

import json
import math
import sqlite3
from pathlib import Path

import pytest
import yaml

from controller.daemon.ledger import Ledger

ARM = str(Path(__file__).parents[2] / "deploy" / "planar16.yaml")


@pytest.fixture(autouse=True)
def _own_folders(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def spatial(tmp_path):
    """An arm of six spatial modules without boards."""
    turned = [0.0, math.sin(0.25), 0.0, math.cos(0.25)]
    states = [{"position": [0, 0, 0.1]}, {"position": [0.02, 0.0, 0.12], "orientation": turned}]
    states += [{"position": [0.0, 0.03, 0.11]}]
    file = tmp_path / "spatial.yaml"
    modules = [{"type": "transforms", "count": 6, "states": states}]
    file.write_text(yaml.safe_dump({"name": "s", "modules": modules, "tolerance": {"position": 0.01}}))
    return str(file)


def test_fk_prints_position_and_orientation_exactly_so(hyperbit):
    code, out, _ = hyperbit("fk", ARM, "4646676700771206", "--json")
    found = json.loads(out)
    assert code == 0
    assert list(found) == ["position", "orientation"]
    assert found["position"] == pytest.approx([3.0, 0.7], abs=1e-3)
    assert found["orientation"] == pytest.approx(-1.621, abs=1e-3)


def test_fk_of_a_spatial_arm_gives_a_quaternion(hyperbit, spatial):
    code, out, _ = hyperbit("fk", spatial, "000000", "--json")
    assert code == 0
    assert json.loads(out)["position"] == pytest.approx([0, 0, 0.6])
    assert json.loads(out)["orientation"] == pytest.approx([0, 0, 0, 1])


@pytest.mark.parametrize("states", ["46", "4646676700771208", "464667670077120x", ""])
def test_a_wrong_configuration_is_unusable_input(hyperbit, states):
    code, out, err = hyperbit("fk", ARM, states)
    assert code == 2
    assert out == ""
    assert "CONFIGURATION" in err


def test_plan_prints_one_line_of_json(hyperbit):
    code, out, _ = hyperbit("plan", ARM, "--goal", "0.55,2.9", "--json")
    [line] = [json.loads(text) for text in out.splitlines()]
    assert code == 0
    assert list(line) == [
        *("goal", "configuration", "position", "orientation"),
        *("error", "orientation_error", "switches", "within_tolerance", "seconds", "cost", "optimal", "lower_bound"),
    ]
    assert line["goal"] == [0.55, 2.9]
    assert line["orientation_error"] is None
    assert line["lower_bound"] <= line["switches"]
    assert line["optimal"] is (line["lower_bound"] >= line["switches"])
    assert line["within_tolerance"] is True
    assert line["error"] == pytest.approx(math.dist(line["position"], line["goal"]))
    assert line["switches"] == sum(bin(int(digit)).count("1") for digit in line["configuration"])


def test_plan_leaves_an_actuator_that_is_declared_stuck(hyperbit, tmp_path):
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
    assert "--previous: 0000000000000000: as actuators are stuck, module 3 has no configuration" in err


@pytest.mark.parametrize("method", ["minimum-switch", "pop", "ipop-previous", "ipop-contracted"])
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


def test_goals_of_a_file_start_where_the_one_before_ended_unless_told(hyperbit, tmp_path):
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y,previous\n0.55,2.9,\n0.55,2.9,\n0.55,2.9,0000000000000000\n")
    code, out, _ = hyperbit("plan", ARM, "--goals", str(goals), "--json")
    first, second, third = (json.loads(text) for text in out.splitlines())
    assert code == 0
    assert second["switches"] == 0
    assert second["configuration"] == first["configuration"]
    assert third["switches"] == first["switches"] > 0


def test_a_goal_out_of_reach_fails_but_a_list_of_goals_is_reported(hyperbit, tmp_path):
    code, out, err = hyperbit("plan", ARM, "--goal", "9,9", "--json")
    assert code == 1
    assert json.loads(out)["within_tolerance"] is False
    assert "nearest" in err
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y\n9,9\n0.5,2.5\n")
    code, out, _ = hyperbit("plan", ARM, "--goals", str(goals), "--json")
    assert code == 0
    assert [json.loads(text)["within_tolerance"] for text in out.splitlines()] == [False, True]


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


def test_map_fills_the_cache_once(hyperbit, tmp_path, spatial):
    code, out, _ = hyperbit("map", spatial, "--json")
    assert code == 0
    assert json.loads(out)["levels"] == 7
    [kept] = (tmp_path / "cache" / "hyperbit").iterdir()
    before = kept.stat().st_mtime_ns
    hyperbit("map", spatial)
    assert kept.stat().st_mtime_ns == before
    hyperbit("map", spatial, "--rebuild")
    assert kept.stat().st_mtime_ns > before


@pytest.mark.parametrize("name", ["revolute24", "platform8", "motor12"])
def test_every_arm_is_checked_mapped_and_planned(hyperbit, name, tmp_path):
    arm = yaml.safe_load((Path(ARM).parent / f"{name}.yaml").read_text())
    arm["workspace"] = {"memory": 4}  # coarser, so quicker
    file = tmp_path / f"{name}.yaml"
    file.write_text(yaml.safe_dump(arm))
    assert json.loads(hyperbit("check", str(file), "--json")[1]) == {"ok": True, "faults": [], "boards": []}
    assert json.loads(hyperbit("map", str(file), "--json")[1])["megabytes"] <= 4.2
    joints = sum(group["count"] for group in arm["modules"])
    states = [{"revolute24": k % 2, "platform8": 9 * k, "motor12": k}[name] for k in range(joints)]
    written = ("" if name == "revolute24" else ",").join(map(str, states))
    code, out, _ = hyperbit("fk", str(file), written, "--json")
    goal = json.loads(out)["position"]
    assert (code, len(goal)) == (0, 2 if name == "revolute24" else 3)
    code, out, _ = hyperbit("plan", str(file), "--goal", ",".join(map(str, goal)), "--json")
    found = json.loads(out)
    assert (code, found["within_tolerance"]) == (0, True)
    assert json.loads(hyperbit("fk", str(file), found["configuration"], "--json")[1])["position"] == found["position"]


def test_check_names_every_fault_and_opens_nothing(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    arm = yaml.safe_load(Path(ARM).read_text())
    arm["speed"], arm["actuators"][3]["node"] = 3, 400
    file.write_text(yaml.safe_dump(arm))
    code, out, err = hyperbit("check", str(file))
    assert (code, out) == (2, "")
    assert [line.split(": ")[1] for line in err.splitlines()] == ["speed", "actuators[3].node"]
    code, out, _ = hyperbit("check", str(file), "--json")
    assert code == 2
    assert json.loads(out)["ok"] is False
    assert len(json.loads(out)["faults"]) == 2
    for command in (
        ("run", str(file)),
        ("simulate", str(file)),
        ("map", str(file)),
        ("plan", str(file), "--goal", "1,2"),
    ):
        assert hyperbit(*command)[0] == 2
    assert not (tmp_path / "cache").exists()
    assert not (tmp_path / "state").exists()


def test_check_of_a_good_file(hyperbit):
    assert hyperbit("check", ARM)[0] == 0
    code, out, _ = hyperbit("check", ARM, "--json")
    assert code == 0
    assert json.loads(out) == {"ok": True, "faults": [], "boards": []}


def test_an_arm_without_boards_is_not_run(hyperbit, spatial):
    for command in ("run", "simulate", "demo"):
        code, _, err = hyperbit(command, spatial)
        assert code == 2
        assert "actuators" in err


def test_a_bus_that_is_not_there_fails_in_words(hyperbit, tmp_path):
    arm = yaml.safe_load(Path(ARM).read_text())
    arm["buses"][0]["channel"] = "no-such-bus"
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(arm))
    for command in (
        ("run", str(file), "--listen", "tcp/127.0.0.1:0"),
        ("simulate", str(file)),
        ("check", str(file), "--bus"),
    ):
        code, _, err = hyperbit(*command)
        assert code == 1
        assert "no-such-bus" in err or "bus cannot be opened" in err


def test_a_daemon_that_is_not_there_fails_in_words(hyperbit):
    for command in (("send", "planar16", "--to", "1,2"), ("watch", "planar16")):
        code, _, err = hyperbit(*command, "--connect", "tcp/127.0.0.1:1")
        assert code == 1
        assert "no daemon at tcp/127.0.0.1:1" in err


@pytest.mark.parametrize("words", [(), ("--to", "a"), ("no-such-goal.yaml",), ("goal.yaml", "--to", "1,2")])
def test_unusable_words_of_send_end_with_2(hyperbit, words):
    code, out, err = hyperbit("send", "planar16", *words)
    assert (code, out) == (2, "")
    assert err


def test_wear_reads_the_ledger(hyperbit, tmp_path):
    path = tmp_path / "ledger.sqlite"
    assert hyperbit("wear", ARM, "--ledger", str(path))[0] == 1
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE something (x)")
    assert hyperbit("wear", ARM, "--ledger", str(path))[0] == 1
    path.unlink()
    ledger = Ledger(path, ["1.left", "1.diagonal"])
    ledger.accepted(1, "a", 2)
    ledger.ended(1, "succeeded", 0, "reached", 5)
    ledger.close()
    code, out, _ = hyperbit("wear", ARM, "--ledger", str(path), "--json")
    assert code == 0
    assert json.loads(out)["switches"]["1.left"] == 0
    assert json.loads(out)["goals"][0]["status"] == "succeeded"
    assert "1 succeeded" in hyperbit("wear", ARM, "--ledger", str(path))[1]


def test_figure5_prints_nine_rows_and_draws(hyperbit, tmp_path):
    picture = tmp_path / "five.png"
    code, out, _ = hyperbit("figure5", "--picture", str(picture), "--json")
    rows = [json.loads(text) for text in out.splitlines()]
    assert code == 0
    assert len(rows) == 9
    assert max(row["error"] for row in rows) <= 0.003
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_help_lists_all_commands(hyperbit):
    code, out, _ = hyperbit("--help")
    assert code == 0
    for command in [
        "run",
        "simulate",
        "demo",
        "send",
        "watch",
        "plan",
        "fk",
        "map",
        "figure5",
        "check",
        "wear",
        "calibrate",
    ]:
        assert command in out
