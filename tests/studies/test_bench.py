"""The benchmark on two worker processes: equal results, methods of users, and the time limit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

import pytest

from hyperbit.controller.bench.goal_sets import read, sample_evenly
from hyperbit.controller.bench.methods import METHODS, Prepare, find_method
from hyperbit.controller.bench.running import PART, Row, run
from hyperbit.controller.studies.shares import Job, StudyFailed, alone
from hyperbit.controller.studies.stream import results

TASKS = sample_evenly(read("lattice"), 60) + read("planar16")[:20]
MINE = """
import os, threading
from pathlib import Path

folder = Path({folder!r})

def count(arm):
    with (folder / "prepared").open("a") as file:
        file.write(f"{{os.getpid()}}\\n")
    return lambda goal, start: start

def endless(arm):
    def solve(goal, start):
        assert threading.current_thread() is not threading.main_thread()
        while True:
            pass
    return solve
"""


@pytest.fixture
def spread(client):
    def spread(job: Job, shares: Iterable[Any]) -> Iterator[Any]:
        for found in results(job, shares, client):
            yield from found

    return spread


@pytest.fixture
def mine(tmp_path):
    """Returns a method of the file MINE, which is gone then."""

    def mine(name: str) -> Prepare:
        file = tmp_path / "mine.py"
        file.write_text(MINE.format(folder=str(tmp_path)))
        found = find_method(f"{file}:{name}")
        file.unlink()
        return found

    return mine


def timeless(row: Row) -> dict[str, Any]:
    return {name: value for name, value in asdict(row).items() if "seconds" not in name}


@pytest.mark.parametrize("name", ["pop", "ipop-fewest-switches", "two-by-two", "k-switch-3"])
def test_rows_are_those_of_one_process(spread, name):
    method = find_method(METHODS[name].target)
    row = run(name, method, TASKS, 60.0, spread)
    assert timeless(row) == timeless(run(name, method, TASKS, 60.0, alone))
    assert 0 < row.goals <= len(TASKS)
    assert row.errors == {}


def test_each_worker_prepares_a_method_of_a_file_once(spread, mine, tmp_path):
    tasks = read("planar16")
    row = run("mine", mine("count"), tasks, 60.0, spread)
    assert (row.goals, row.errors) == (len(tasks), {})
    processes = (tmp_path / "prepared").read_text().split()
    assert len(set(processes)) == len(processes) <= 2 < len(tasks) // PART


def test_a_method_that_takes_too_long_is_ended_in_the_thread_of_a_worker(spread, mine):
    assert run("mine", mine("endless"), read("planar16")[:3], 0.02, spread).errors == {"took too long": 3}


def test_a_method_of_a_module_that_workers_do_not_have_is_refused(spread, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def prepare(arm):\n    return lambda goal, start: start\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(StudyFailed, match=r"needs the modules of this computer: ModuleNotFoundError: .*'only_here'"):
        run("mine", find_method("only_here:prepare"), TASKS, 60.0, spread)
