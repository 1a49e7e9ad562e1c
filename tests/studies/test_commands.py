"""Commands that share work print the same bytes from one process and from two workers."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from distributed import Client

from hyperbit.controller.commands import sharing
from hyperbit.controller.manipulator.notation import format_configuration
from tests.calibration.making import TRUSSES, arm_of, erring, measured

LONG = """
name: long
modules: [{type: vgt, count: 14, width: 0.2, lengths: [0.2, 0.25]}]
tolerance: {position: 0.01}
workspace: {memory: 4}
"""
TWO = ("--workers", "2")
MINE = """
def boast(arm):
    class Answer:
        certificate = "optimal"
        def __init__(self, configuration):
            self.configuration = configuration
    return lambda goal, start: Answer(start)
"""


@pytest.fixture(autouse=True)
def shared(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def workers(count: int) -> nullcontext[Client]:
        assert count == 2
        return nullcontext(client)

    monkeypatch.setattr(sharing, "local_workers", workers)


@pytest.fixture
def samples(tmp_path):
    arm, rng = arm_of(tmp_path, [{**TRUSSES[0], "count": 3}]), np.random.default_rng(3)
    found = measured(arm, erring(arm, rng, each=True), rng, 40)
    rows = [
        f"{format_configuration(arm.manipulator, configuration)},{float(tip[0, 3])!r},{float(tip[1, 3])!r}\n"
        for configuration, tip in zip(found.configurations, found.tips, strict=True)
    ]
    file = tmp_path / "samples.csv"
    file.write_text("configuration,x,y\n" + "".join(rows))
    return str(tmp_path / "arm.yaml"), str(file)


@pytest.mark.usefixtures("own_folders")
def test_workspace_prints_the_same_figures(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_text(LONG)
    words = "workspace", str(file), "--locked", "2", "--samples", "20", "--picture", str(tmp_path / "p.png"), "--json"
    code, alone, _ = hyperbit(*words)
    assert code == 0
    assert '"draws"' in alone
    assert hyperbit(*words, *TWO)[:2] == (0, alone)


@pytest.mark.usefixtures("own_folders")
def test_calibrate_prints_the_same_numbers(hyperbit, samples):
    words = "calibrate", *samples, "--each", "--json"
    alone = hyperbit(*words)
    assert alone[0] in (0, 1)
    assert alone[1]
    assert hyperbit(*words, *TWO)[:2] == alone[:2]


@pytest.mark.usefixtures("own_folders")
def test_bench_changes_nothing_but_times(hyperbit, client, tmp_path):
    def figures(file):
        found = json.loads(file.read_text())
        rows = [row for of_set in found["sets"].values() for row in of_set["methods"]]
        return [{name: value for name, value in row.items() if "seconds" not in name} for row in rows], found["workers"]

    (tmp_path / "mine.py").write_text(MINE)
    words = ("bench", "--set", "revolute24", "--count", "20", "--methods", "pop,two-by-two", "--method")
    words += (f"{tmp_path / 'mine.py'}:boast", "--json")
    code, out, _ = hyperbit(*words, str(tmp_path / "1.json"))
    assert code == 0
    assert "several workers" not in out
    code, out, _ = hyperbit(*words, str(tmp_path / "2.json"), *TWO)
    assert code == 0
    assert "Times were measured while several workers shared the processors" in out
    (alone, one), (shared, count) = figures(tmp_path / "1.json"), figures(tmp_path / "2.json")
    assert (shared, one, count) == (alone, 1, 2)
    assert all(client.run(prints_on_stderr).values()), "what a method prints in a worker is among the figures"


def prints_on_stderr() -> bool:
    return sys.stdout is sys.stderr


def test_both_options_contradict_each_other(hyperbit, samples):
    code, _, err = hyperbit("calibrate", *samples, *TWO, "--dask", "tcp://127.0.0.1:1")
    assert code == 2
    assert "the cluster has its own workers: leave out --workers" in err
