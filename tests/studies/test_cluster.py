"""Studies on two worker processes: order, equal results, and the sentences of what does not fit."""

from __future__ import annotations

import importlib.metadata
import itertools
import os
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import hyperbit as hb
from hyperbit.controller.studies import stream, workers
from hyperbit.controller.studies.shares import Run, StudyFailed, compute, pack
from hyperbit.controller.studies.stream import results
from hyperbit.controller.studies.workers import check_workers, cluster_workers
from tests.studies.conftest import ARM, answers


class Squares(NamedTuple):
    """A study of numbers; a negative one ends its worker."""

    def prepare(self) -> Run:
        return self._run

    def _run(self, share: list[int]) -> Iterator[int]:
        for number in share:
            if number < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            yield number * number


class Lengths(NamedTuple):
    def prepare(self) -> Run:
        return partial(map, len)


def test_results_have_the_order_of_the_shares(client):
    shares = [[k, k + 1] for k in range(50)]
    assert list(results(Squares(), shares, client)) == [[k * k, (k + 1) ** 2] for k in range(50)]
    assert [one for [one] in results(Squares(), [[1, 2], [3]])] == [1, 4, 9]


def test_shares_are_read_as_they_are_needed(client):
    read = itertools.count()
    found = results(Squares(), ([next(read)] for _ in itertools.repeat(None)), client)
    assert [next(found) for _ in range(20)] == [[k * k] for k in range(20)]
    assert next(read) <= 20 + 2 * stream.AHEAD
    found.close()


def test_shares_that_are_done_leave_the_memory(client):
    shares, before = ([os.urandom(200_000)] for _ in range(300)), memory()
    assert all(found == [200_000] for found in results(Lengths(), shares, client))
    assert memory() - before < 30  # of 60


def memory() -> float:
    """Returns the memory that this process has [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_plan_prints_the_same_bytes_from_one_process_and_from_a_cluster(client, ik, goals, run_plan, tmp_path):
    file, output = tmp_path / "goals.csv", tmp_path / "out.jsonl"
    rows = [(*goal.tolist(), "" if k % 3 else "1" * 16) for k, goal in enumerate(goals[:70])]
    file.write_text("x,y,previous\n" + "".join(f"{x!r},{y!r},{previous}\n" for x, y, previous in rows))
    words = "--goals", str(file), "--apart", "--effort", "5"
    address = client.scheduler.address
    code, alone, _ = run_plan(*words, "--json")
    assert (code, alone.count("\n")) == (0, 70)
    assert run_plan(*words, "--json", "--dask", address)[:2] == (0, alone)
    code, out, err = run_plan(*words, "--dask", address, "--output", str(output))
    assert (code, out, output.read_text().partition("\n")[2]) == (0, "", alone)
    assert f"{output} has the results of 70 goals" in err


@pytest.fixture
def run_plan(hyperbit):
    return partial(hyperbit, "plan", ARM)


def version_but(package: str, found: Any, asked: str) -> Any:
    if asked == package:
        if isinstance(found, Exception):
            raise found
        return found
    return importlib.metadata.Distribution.from_name(asked).version


@pytest.mark.parametrize(
    ("package", "found", "sentence"),
    [
        ("hyperbit", "0.0.1", "has hyperbit 0.0.1, and this study needs {own}: install hyperbit {own} there"),
        ("hyperbit", importlib.metadata.PackageNotFoundError("hyperbit"), "has no hyperbit, here is {own}: install"),
        ("numba", importlib.metadata.PackageNotFoundError("numba"), "has no numba, here is"),
    ],
)
def test_a_worker_without_the_right_packages_is_named(client, package, found, sentence, monkeypatch):
    own = importlib.metadata.version("hyperbit")
    asked = client.run

    def run(function: Any, *words: Any, **how: Any) -> Any:
        return asked(partial(version_but, package, found), *words, **how)

    monkeypatch.setattr(client, "run", run)
    with pytest.raises(StudyFailed) as error:
        check_workers(client)
    assert str(error.value).startswith("worker tcp://127.0.0.1:")
    assert sentence.format(own=own) in str(error.value)


def test_a_share_of_another_version_is_refused_where_it_arrives():
    job = pack(Squares())._replace(version="0.0.1")
    with pytest.raises(StudyFailed, match=r"and this study needs 0\.0\.1"):
        compute(job, [1])


def test_a_scheduler_with_another_dask_is_named(client, monkeypatch):
    versions = client.get_versions()
    versions["scheduler"]["packages"]["distributed"] = "1.0.0"
    monkeypatch.setattr(client, "get_versions", lambda: versions)
    with pytest.raises(StudyFailed, match=r"runs Dask 1\.0\.0, and this computer 2\d+\.\d+"):
        check_workers(client)


def test_a_scheduler_that_is_not_there_is_a_sentence(monkeypatch, run_plan, tmp_path):
    monkeypatch.setattr(workers, "CONNECT", 0.2)
    file = tmp_path / "goals.csv"
    file.write_text("x,y\n0.5,2.9\n")
    code, _, err = run_plan("--goals", str(file), "--apart", "--dask", "tcp://127.0.0.1:1")
    assert code == 1
    assert err.startswith("tcp://127.0.0.1:1: no Dask scheduler answers")
    assert err.rstrip().endswith("start one with `dask scheduler`")


def test_a_cluster_without_workers_is_a_sentence():
    from distributed import LocalCluster

    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0", host="127.0.0.1") as empty,
        pytest.raises(StudyFailed, match="has no workers: start one with `dask worker tcp"),
        cluster_workers(empty.scheduler_address),
    ):
        pass


def test_an_error_of_a_goal_ends_the_study_and_leaves_the_workers_sound(client, ik, goals):
    with pytest.raises(hb.GoalError, match="a goal of this arm has 2 coordinates, got 3"):
        list(hb.map(ik, [goals[0], (1.0, 2.0, 3.0)], client=client, effort=5))
    assert len(answers(hb.map(ik, goals[:2], client=client, effort=5))) == 2


def test_wrong_arguments_of_map_are_refused_at_once(ik):
    with pytest.raises(hb.StudyError, match="workers: a whole number from 1"):
        hb.map(ik, [], workers=0)
    with pytest.raises(hb.GoalError, match="effort: a positive number"):
        hb.map(ik, [], effort=0)
    assert list(hb.map(ik, [])) == []
