"""Long plans on a Dask cluster of a scheduler and two workers, each a process of its own."""

from __future__ import annotations

import importlib.metadata
import logging
import multiprocessing
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from distributed import Client

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.core.tasks import Described, Failed, Refused
from hyperbit.controller.planning.workers import cluster_plans
from hyperbit.controller.planning.workers.arm_model import Abandoned, ArmModel
from hyperbit.controller.planning.workers.cluster_plans import ClusterPlanner, left_after, proceed_on_cluster
from hyperbit.controller.planning.workers.computations import describe
from hyperbit.controller.planning.workers.long_plans import LongPlanner, Planner, packed
from tests.dask_cluster import DaskCluster, dask_cluster
from tests.planning.workers.conftest import Bench, nothing
from tests.planning.workers.test_long_plans import FAR, proven, task
from tests.waiting import PATIENCE, eventually

NOBODY = "tcp://127.0.0.1:1"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with dask_cluster(2, tmp_path_factory.mktemp("cluster")) as cluster:
        yield cluster


@pytest.fixture
def expected(bench: Bench) -> list[Any]:
    return proven(describe(ArmModel(bench.arm, "queries"), task(bench), nothing, lambda: False))


def with_dask(bench: Bench, address: str) -> Arm:
    settings = bench.arm.settings
    planning = msgspec.structs.replace(settings.planning, dask=address)
    return replace(bench.arm, settings=msgspec.structs.replace(settings, planning=planning))


@pytest.fixture
def planner_of(bench: Bench) -> Iterator[Any]:
    """Returns the planner of an address, which is closed at the end."""
    opened = list[ClusterPlanner]()

    def planner(address: str) -> ClusterPlanner:
        opened.append(ClusterPlanner(address, bench.arm, bench.weights, Planner(bench.arm, bench.weights)))
        return opened[-1]

    yield planner
    for one in opened:
        one.close()


def test_the_cluster_answers_as_this_process_does(bench: Bench, cluster: DaskCluster, planner_of: Any, expected: Any):
    planner = planner_of(cluster.address)
    assert planner.wait(PATIENCE), planner._why
    answer, warning = planner.answer_long(packed(task(bench), bench.arm.digest))
    assert (proven(answer), warning) == (expected, "")
    waypoint = msgspec.structs.replace(task(bench).goal.message.waypoints[0], configuration=None, position=list(FAR))
    far = packed(task(bench), bench.arm.digest)
    refused = planner.answer(far._replace(message=msgspec.structs.replace(far.message, waypoints=[waypoint])))
    assert isinstance(refused, Refused)


def test_without_a_scheduler_the_plan_is_computed_at_home(
    bench: Bench, expected: Any, caplog: pytest.LogCaptureFixture
) -> None:
    planner = LongPlanner(with_dask(bench, NOBODY), bench.weights)
    with caplog.at_level(logging.WARNING):
        assert proven(planner.plan(task(bench), nothing)) == expected
    planner.close()
    [record] = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert record.getMessage().startswith(NOBODY)
    assert record.getMessage().endswith("; the plan is computed on this computer instead")


def test_a_plan_that_fails_on_the_cluster_is_computed_at_home(
    bench: Bench, planner_of: Any, expected: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ClusterPlanner, "_stay_connected", lambda self: None)
    planner = planner_of(NOBODY)
    failed = Failed("Traceback (most recent call last):\nMemoryError: no memory\n")
    monkeypatch.setattr(cluster_plans, "result_of", lambda *arguments: [failed])
    monkeypatch.setattr(planner, "_client", SimpleNamespace(submit=lambda *arguments, **options: None))
    answer, warning = planner.answer_long(packed(task(bench), bench.arm.digest))
    assert proven(answer) == expected
    assert warning == f"{NOBODY}: MemoryError: no memory; the plan is computed on this computer instead"


def test_a_scheduler_that_is_away_is_named(planner_of: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyperbit.controller.studies.workers.CONNECT", 0.2)
    planner = planner_of(NOBODY)
    eventually(lambda: "no Dask scheduler answers" in planner._why)
    assert planner._why.startswith(NOBODY)


def test_a_process_of_the_daemon_sends_its_plans_to_the_cluster(
    bench: Bench, cluster: DaskCluster, expected: Any, caplog: pytest.LogCaptureFixture
) -> None:
    planner = LongPlanner(with_dask(bench, cluster.address), bench.weights)

    def on_the_cluster() -> bool:
        caplog.clear()
        assert proven(planner.plan(task(bench), nothing)) == expected
        return not caplog.records

    with caplog.at_level(logging.WARNING):
        eventually(on_the_cluster)  # at home until the workers have their tables
    planner.close()


def test_a_worker_with_another_version_refuses_in_words(
    bench: Bench, cluster: DaskCluster, planner_of: Any, expected: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = cluster_plans.pack
    monkeypatch.setattr(cluster_plans, "pack", lambda job: pack(job)._replace(version="0.0.1"))
    planner = planner_of(cluster.address)
    own = importlib.metadata.version("hyperbit")
    eventually(lambda: f"this worker has hyperbit {own}, and this study needs 0.0.1" in planner._why)
    answer, warning = planner.answer_long(packed(task(bench), bench.arm.digest))
    assert proven(answer) == expected
    assert warning.startswith("this worker has hyperbit")


def test_a_worker_without_numba_is_named(
    cluster: DaskCluster, planner_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = Client.run

    def run(client: Client, function: Any, package: str, **how: Any) -> Any:
        return asked(client, partial(version_but_numba, package), **how)

    monkeypatch.setattr(Client, "run", run)
    planner = planner_of(cluster.address)
    eventually(lambda: "has no numba, here is" in planner._why)


def version_but_numba(package: str) -> str:
    """Stands for importlib.metadata.version on a worker."""
    if package == "numba":
        raise importlib.metadata.PackageNotFoundError(package)
    return importlib.metadata.version(package)


def test_a_plan_is_computed_at_home_when_the_scheduler_dies_meanwhile(
    bench: Bench, planner_of: Any, expected: Any, tmp_path: Path
) -> None:
    with dask_cluster(1, tmp_path) as own:
        planner = planner_of(own.address)
        assert planner.wait(PATIENCE), planner._why
        own.workers[0].send_signal(19)  # SIGSTOP: the plan waits there
        client, submit = planner._client, planner._client.submit

        def submitted(*words: Any, **how: Any) -> Any:
            future = submit(*words, **how)
            own.scheduler.kill()
            return future

        client.submit = submitted
        answer, warning = planner.answer_long(packed(task(bench, 30.0), bench.arm.digest))
    assert proven(answer) == expected
    assert warning.endswith("; the plan is computed on this computer instead")


def spin(folder: str) -> None:
    """Runs on a worker until nobody waits for it."""
    proceed = proceed_on_cluster()
    (Path(folder) / "begun").touch()
    try:
        while True:
            proceed()
            time.sleep(0.01)
    except Abandoned:
        (Path(folder) / "ended").touch()


def submit(address: str, folder: str) -> None:
    """Asks for `spin`, and waits."""
    with Client(address) as client:
        client.submit(spin, folder, pure=False).result()


def test_a_plan_ends_on_the_cluster_when_the_process_that_asked_is_killed(cluster: DaskCluster, tmp_path: Path) -> None:
    spawn = multiprocessing.get_context("spawn")
    process = spawn.Process(target=submit, args=(cluster.address, str(tmp_path)))
    process.start()
    eventually(lambda: (tmp_path / "begun").exists())
    process.kill()
    process.join()
    eventually(lambda: (tmp_path / "ended").exists())


def test_the_time_that_was_lost_is_taken_from_the_deadline(bench: Bench) -> None:
    plan = packed(task(bench, 5.0), bench.arm.digest)
    assert left_after(plan, 2.0).message.deadline == pytest.approx(3.0)
    assert left_after(plan, 9.0).message.deadline == pytest.approx(cluster_plans.PLANNING_TIME)
    assert isinstance(Planner(bench.arm, bench.weights).answer(left_after(plan, 9.0)), Described)
