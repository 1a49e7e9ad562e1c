"""The commands plan for single goals and trajectories, bench and workspace; plan --apart is in test_plan_apart.py."""

from __future__ import annotations

import json
import math

import pytest
import yaml

import hyperbit as hb
from hyperbit.controller.bench import running
from hyperbit.controller.bench.goal_sets import SETS
from hyperbit.controller.bench.methods import METHODS
from hyperbit.controller.commands import common
from hyperbit.controller.commands.study.plan_rows import sentence
from hyperbit.controller.motion.plans import whole
from hyperbit.controller.search.method import METHODS as SEARCHES
from tests.commands.conftest import ARM

pytestmark = pytest.mark.usefixtures("own_folders")

SHORT = "name: short\ntolerance: {position: 0.01}\nmodules: [{type: vgt, count: 4, width: 0.2, lengths: [0.2, 0.25]}]\n"


@pytest.fixture
def plan(hyperbit, tmp_path):
    """Runs `plan`, for goals in a file if a text is given; returns the exit code, the lines of JSON, and stderr."""

    def run(*words: str, goals: str | None = None, arm: str = str(ARM)):
        if goals is not None:
            (tmp_path / "goals.csv").write_text(goals)
            words = ("--goals", str(tmp_path / "goals.csv"), *words)
        code, out, err = hyperbit("plan", arm, *words, "--json")
        return code, [json.loads(text) for text in out.splitlines()], err

    return run


def test_plan_prints_one_line_of_json(plan):
    code, [line], _ = plan("--goal", "0.55,2.9")
    assert code == 0
    assert list(line) == [
        *("goal", "configuration", "position", "orientation"),
        *("error", "orientation_error", "switches", "seconds", "cost", "optimal", "lower_bound"),
        *("certificate", "within_tolerance"),
    ]
    assert (line["goal"], line["orientation_error"], line["within_tolerance"]) == ([0.55, 2.9], None, True)
    assert line["lower_bound"] <= line["switches"]
    assert line["optimal"] is (line["lower_bound"] >= line["switches"])
    assert line["error"] == pytest.approx(math.dist(line["position"], line["goal"]))
    assert line["switches"] == sum(bin(int(digit)).count("1") for digit in line["configuration"])


def test_plan_does_not_switch_an_actuator_that_is_declared_stuck(hyperbit, plan, tmp_path):
    document, file = yaml.safe_load(ARM.read_text()), tmp_path / "stuck.yaml"
    for entry in document["actuators"]:
        if entry["module"] == 3 and entry["actuator"] in ("left", "right"):
            entry["stuck"] = "extended"
    file.write_text(yaml.safe_dump(document))
    for goal in ("0.55,2.9", "-0.4,2.9"):
        code, [line], _ = plan("--goal", goal, arm=str(file))
        found = json.loads(hyperbit("fk", str(ARM), line["configuration"], "--json")[1])
        assert (code, int(line["configuration"][2]) & 0b101) == (0, 0b101)
        assert found["position"] == pytest.approx(line["position"])
    code, _, err = plan("--goal", "0.55,2.9", "--previous", "0" * 16, arm=str(file))
    assert code == 2
    assert "--previous: 0000000000000000: as actuators are locked, module 3 has no state" in err


@pytest.mark.parametrize("method", SEARCHES)
def test_plan_takes_method_tolerance_and_previous(plan, method):
    options = ("--method", method, "--tolerance", "0.004", "--previous", "0123456701234567")
    code, [line], _ = plan("--goal", "-1.0,2.2", *options)
    assert code == 0
    assert line["error"] <= 0.004


def test_goals_of_a_file_start_at_the_previous_goal_by_default(plan):
    code, lines, _ = plan(goals="x,y,previous\n0.55,2.9,\n0.55,2.9,\n0.55,2.9,0000000000000000\n")
    first, second, third = lines
    assert (code, second["switches"], second["configuration"]) == (0, 0, first["configuration"])
    assert third["switches"] == first["switches"] > 0


def test_goals_of_a_file_are_planned_as_the_library_plans_a_path(hyperbit, plan, tmp_path, monkeypatch):
    monkeypatch.setattr(whole, "WHOLE_TIME", 60.0)  # so that both prove the minimum of switches on any machine
    file = tmp_path / "short.yaml"
    file.write_text(SHORT)
    arm = hb.load(file)
    tips = arm.frames(arm.sample(3, seed=2))[:, :2, 3]
    goals = "x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in tips.tolist())
    _, lines, _ = plan(goals=goals, arm=str(file))
    path = hb.Solver(arm).follow(list(tips))
    proven = {"switches": path.switches, "cost": path.cost, "optimal": True}
    proven |= {"lower_bound": path.lower_bound, "certificate": "optimal", "gap": 0.0}
    assert [line["trajectory"] for line in lines] == [proven] * 3
    assert sum(line["switches"] for line in lines) == path.switches == path.lower_bound
    words = ("plan", str(file), "--goals", str(tmp_path / "goals.csv"), "--prove", "--deadline", "60")
    assert f"{path.switches} switches in all; proven to be the fewest" in hyperbit(*words)[1]


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


def test_a_goal_out_of_reach_fails_but_a_list_of_goals_is_reported(plan):
    code, [line], err = plan("--goal", "9,9")
    assert (code, line["within_tolerance"], "nearest" in err) == (1, False, True)
    code, lines, err = plan(goals="x,y\n9,9\n0.5,2.5\n")
    assert (code, [line["within_tolerance"] for line in lines]) == (0, [False, True])
    assert "no plan of the whole trajectory: waypoint 1" in err


def test_plan_takes_an_angle_and_its_tolerance(plan):
    code, [line], _ = plan("--goal", "0.55,2.9,0.3", "--turn", "0.02", "--tolerance", "0.005")
    assert (code, line["goal"]) == (0, [0.55, 2.9])
    assert line["orientation_error"] == pytest.approx(abs(line["orientation"] - 0.3))
    assert line["orientation_error"] <= 0.02
    code, _, err = plan("--goal", "0.55,2.9,3.0")
    assert (code, "and turned" in err) == (1, True)
    code, lines, _ = plan(goals="x,y,th\n0.55,2.9,0.3\n0.55,2.9,\n")
    assert (code, [line["orientation_error"] is None for line in lines]) == (0, [False, True])


def test_plan_takes_a_quaternion(hyperbit, plan, spatial):
    tip = json.loads(hyperbit("fk", spatial, "012012", "--json")[1])
    goal = ",".join(f"{x:.6f}" for x in [*tip["position"], *tip["orientation"]])
    code, [line], _ = plan("--goal", goal, "--tolerance", "0.0001", arm=spatial)
    assert (code, line["orientation_error"] <= 0.05) == (0, True)


def test_goals_of_a_file_are_followed_along_lines(plan, hyperbit, tmp_path):
    code, lines, _ = plan("--path-tolerance", "0.05", goals="x,y\n0.55,2.9\n0.55,2.8\n0.51,2.8\n")
    assert (code, [line["between"] for line in lines]) == (0, [False, *[True] * 7, False, *[True] * 3, False])
    assert [line["goal"] for line in lines if not line["between"]] == [[0.55, 2.9], [0.55, 2.8], [0.51, 2.8]]
    assert all(line["within_tolerance"] and line["error"] < 0.05 for line in lines)
    assert sum(line["switches"] > 0 for line in lines) < len(lines) / 2
    words = ("plan", str(ARM), "--goals", str(tmp_path / "goals.csv"), "--path-tolerance", "0.05")
    assert hyperbit(*words)[1].count("\n  0.") == 10
    code, lines, err = plan("--path-tolerance", "0.05", goals="x,y\n-2.6,1.5\n2.6,1.5\n")
    assert (code, lines, "waypoint 1 to 2: (" in err) == (1, [], True)


FEW = ("bench", "--set", "revolute24", "--count", "3")
MINE = """
import hyperbit as hb

def prepare(arm):
    print("noise")
    return hb.Solver(arm.arm).solve

def boast(arm):
    class Answer:
        certificate = "optimal"
        def __init__(self, configuration):
            self.configuration = configuration
    return lambda goal, start: Answer(start)

def fail(arm):
    return lambda goal, start: 1 / 0
"""


def test_the_figures_of_chosen_methods(hyperbit, tmp_path, monkeypatch):
    file = tmp_path / "figures.json"
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delattr(common, "console", raising=False)  # its width is that of the first use
    code, out, _ = hyperbit(*FEW, "--methods", "minimum-switch, pop", "--json", str(file))
    assert (code, "minimum-switch" in out) == (0, True)
    assert "…" not in out, "a cell is shortened"
    [(name, of_set)] = json.loads(file.read_text())["sets"].items()
    assert (name, of_set["goals"], of_set["certified"]) == ("revolute24", 3, 3)
    ours, plain = of_set["methods"]
    assert (ours["method"], ours["goals"], ours["solved"], ours["wrong_certificates"]) == ("minimum-switch", 3, 3, 0)
    assert plain["method"] == "pop"
    assert 0 < ours["seconds_median"] <= ours["seconds_99"]


def test_a_method_of_ones_own_is_compared_with_minimum_switch(hyperbit, tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    names = [f"{tmp_path}/mine.py:{name}" for name in ("prepare", "boast", "fail")]
    code, out, err = hyperbit(*FEW, *(word for name in names for word in ("--method", name)), "--json", "-")
    assert (code, "noise" in err) == (0, True)
    ours, same, boasting, failing = json.loads(out)["sets"]["revolute24"]["methods"]
    assert [row["method"] for row in (same, boasting, failing)] == names
    assert (same["solved"], same["switches"], same["errors"]) == (3, ours["switches"], {})
    assert (boasting["solved"], boasting["proven"], boasting["wrong_certificates"]) == (0, 0, 3)
    assert failing["errors"] == {"raised ZeroDivisionError": 3}
    assert failing["examples"] == ["goal 1: raised ZeroDivisionError: division by zero"]


def test_names_are_listed(hyperbit):
    code, out, _ = hyperbit("bench", "--list")
    assert (code, [name for name in (*SETS, *METHODS) if f"  {name} " not in out]) == (0, [])


def test_ctrl_c_ends_with_what_is_complete(hyperbit, monkeypatch):
    run = running.run

    def interrupted(name, prepare, tasks, limit, spread):
        if tasks[0].arm == "planar16":
            raise KeyboardInterrupt
        return run(name, prepare, tasks, limit, spread)

    monkeypatch.setattr(running, "run", interrupted)
    words = "bench", "--count", "2", "--methods", "pop", "--set"
    assert hyperbit(*words, "planar16") == (130, "", "interrupted: no result is kept\n")
    code, out, err = hyperbit(*words, "revolute24", "--set", "planar16")
    assert (code, "pop" in out) == (130, True)
    assert "the tables of these sets are complete: revolute24; choose the others with --set" in " ".join(err.split())


PLANAR = SHORT.replace("4", "5", 1)
SPATIAL = """
name: solid
modules:
  - {type: revolute, count: 6, axis: [1, 0, 0], angles: [-0.5, 0.5], link: {position: [0, 0, 0.2]}}
  - {type: revolute, count: 6, axis: [0, 1, 0], angles: [-0.5, 0.5], link: {position: [0, 0, 0.2]}}
tolerance: {position: 0.2}
"""


@pytest.fixture
def workspace(hyperbit, tmp_path):
    """Runs `workspace` for an arm's file of this text."""

    def run(text: str, *words: str):
        (tmp_path / "arm.yaml").write_text(text)
        return hyperbit("workspace", str(tmp_path / "arm.yaml"), "--picture", str(tmp_path / "picture.png"), *words)

    return run


@pytest.mark.parametrize(("arm", "point", "far"), [(PLANAR, "0.1,0.95", "9,9"), (SPATIAL, "0.2,0.1,2.1", "9,9,9")])
def test_positions_orientations_and_locks(workspace, tmp_path, arm, point, far):
    code, out, _ = workspace(arm, "--at", point, "--locked", "1", "--json")
    told = json.loads(out)
    assert (code, told["positions"]["method"], told["locked"]["method"]) == (0, "listing", "mapping")
    assert all(told[part]["why"] for part in ("positions", "at", "locked"))
    covered, redundancy = told["positions"]["covered"], told["positions"]["log10_redundancy"]
    assert 0 < covered["lower"] <= covered["estimate"] <= covered["upper"] < covered["lower"] * 1.2
    assert 0 <= redundancy["lower"] <= redundancy["upper"] <= told["positions"]["log10_greatest_redundancy"]
    assert told["at"]["configurations"] > 0
    assert not [name for name in told["positions"] if name in told["at"] and name not in ("method", "why")]
    shares = told["at"]["angles"] if "angles" in told["at"] else told["at"]["twists"]
    assert sum(shares) == pytest.approx(1)
    worst, locked = told["locked"]["worst"]["reach"], told["locked"]
    assert worst["reach"] == min(choice["reach"] for choice in locked["choices"])
    assert worst["reach"] <= locked["mean"]["reach"] <= locked["free"]["reach"] * 1.05
    assert len(worst["locked"]) == 1
    picture = tmp_path / "picture.png"
    assert picture.stat().st_size > 10_000
    code, out, _ = workspace(arm, "--at", far, "--locked", "2", "--samples", "3")
    assert code == 0
    for words in ("by listing: ", "by mapping: ", "3 random choices", "log10_redundancy", "worst", str(picture)):
        assert words in out
    told = json.loads(workspace(arm, "--at", far, "--json")[1])["at"]
    assert (told["configurations"], told["mean"]) == (0, None)


def test_figures_do_not_depend_on_the_pixel(workspace):
    fine, coarse = (
        json.loads(workspace(f"{PLANAR}workspace: {{pixel: {pixel}}}\n", "--json")[1])["positions"]
        for pixel in (0.005, 0.05)
    )
    for figure in ("covered", "log10_redundancy"):
        assert fine[figure]["estimate"] == pytest.approx(coarse[figure]["estimate"], rel=0.1, abs=0.04)
