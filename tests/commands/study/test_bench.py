"""The command bench: JSON output, methods of users, refused options."""

from __future__ import annotations

import json

import pytest

from hyperbit.controller.bench import running
from hyperbit.controller.bench.goal_sets import SETS
from hyperbit.controller.bench.methods import METHODS
from hyperbit.controller.commands import common

pytestmark = pytest.mark.usefixtures("own_folders")

FEW = ("--set", "revolute24", "--count", "3")
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

number = 1
"""


@pytest.fixture
def mine(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    return str(file)


def test_the_figures_of_chosen_methods(hyperbit, tmp_path, monkeypatch):
    file = tmp_path / "figures.json"
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delattr(common, "console", raising=False)  # its width is that of the first use
    code, out, _ = hyperbit("bench", *FEW, "--methods", "minimum-switch, pop", "--json", str(file))
    assert "minimum-switch" in out
    assert "…" not in out, "a cell is shortened"
    assert code == 0
    assert "minimum-switch" in out
    figures = json.loads(file.read_text())
    [(name, of_set)] = figures["sets"].items()
    assert (name, of_set["goals"], of_set["certified"]) == ("revolute24", 3, 3)
    ours, plain = of_set["methods"]
    assert (ours["method"], ours["goals"], ours["solved"], ours["wrong_certificates"]) == ("minimum-switch", 3, 3, 0)
    assert plain["method"] == "pop"
    assert 0 < ours["seconds_median"] <= ours["seconds_99"]


def test_a_method_of_ones_own_is_compared_with_minimum_switch(hyperbit, mine):
    own = [word for name in ("prepare", "boast", "fail") for word in ("--method", f"{mine}:{name}")]
    code, out, err = hyperbit("bench", *FEW, *own, "--json", "-")
    assert code == 0
    assert "noise" in err
    ours, same, boasting, failing = json.loads(out)["sets"]["revolute24"]["methods"]
    assert [row["method"] for row in (same, boasting, failing)] == [f"{mine}:{n}" for n in ("prepare", "boast", "fail")]
    assert (same["solved"], same["switches"], same["errors"]) == (3, ours["switches"], {})
    assert (boasting["solved"], boasting["proven"], boasting["wrong_certificates"]) == (0, 0, 3)
    assert failing["errors"] == {"raised ZeroDivisionError": 3}
    assert failing["examples"] == ["goal 1: raised ZeroDivisionError: division by zero"]


def test_names_are_listed(hyperbit):
    code, out, _ = hyperbit("bench", "--list")
    assert code == 0
    assert all(f"  {name} " in out for name in (*SETS, *METHODS))


def test_ctrl_c_ends_with_what_is_complete(hyperbit, monkeypatch):
    run = running.run

    def interrupted(name, prepare, tasks, limit, spread):
        if tasks[0].arm == "planar16":
            raise KeyboardInterrupt
        return run(name, prepare, tasks, limit, spread)

    monkeypatch.setattr(running, "run", interrupted)
    words = "bench", "--count", "2", "--methods", "pop", "--set"
    code, _, err = hyperbit(*words, "planar16")
    assert (code, err) == (130, "interrupted: no result is kept\n")
    code, out, err = hyperbit(*words, "revolute24", "--set", "planar16")
    assert code == 130
    assert "pop" in out
    assert "the tables of these sets are complete: revolute24; choose the others with --set" in " ".join(err.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--workers", "2", "--dask", "tcp://a:1"), "--dask: the cluster has its own workers: leave out --workers"),
        (("--set", "nowhere"), "no set 'nowhere'"),
        (("--methods", "magic"), "no method 'magic'"),
        (("--method", "prepare"), "module:function or file.py:function is needed"),
        (("--method", "missing_module:prepare"), "missing_module cannot be imported: ModuleNotFoundError"),
        (("--method", "missing.py:prepare"), "missing.py cannot be read: No such file"),
        (("--method", "json:missing"), "json has no function 'missing'"),
        (("--method", "math:pi"), "math has no function 'pi'"),
    ],
)
def test_unknown_names_are_refused(hyperbit, words, sentence):
    code, _, err = hyperbit("bench", *words)
    assert code == 2
    assert sentence in err


def test_a_file_that_cannot_be_written_is_refused_before_the_work(hyperbit, tmp_path):
    code, out, err = hyperbit("bench", "--set", "lattice", "--json", str(tmp_path / "gone" / "figures.json"))
    assert (code, out) == (2, "")
    assert "figures.json: cannot be written: No such file or directory" in err
