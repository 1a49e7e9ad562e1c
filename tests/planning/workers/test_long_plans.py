"""Plans in processes of their own."""

import queue
import threading
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hyperbit.controller.arm.arm import load
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import Described, DescribePlan, Done, Failed, Refused
from hyperbit.controller.planning.workers import pool
from hyperbit.controller.planning.workers.computations import Abandoned, ArmModel, describe
from hyperbit.controller.planning.workers.pool import LongPlanner, PlanServer, Workers, answer_plans, packed
from tests.planning.workers.conftest import A, B, Bench, abandoned, nothing
from tests.waiting import PATIENCE

FAR = (9.0, 9.0)


def task(bench: Bench, deadline: float | None = 5.0) -> DescribePlan:
    goal = bench.task(A, B)
    return DescribePlan(goal._replace(message=msgspec.structs.replace(goal.message, deadline=deadline)), 60.0)


def proven(answer: object) -> list[Any]:
    """What does not depend on the time of a search."""
    assert isinstance(answer, Described), answer
    return [getattr(answer.plan, name) for name in ("accepted", "switches", "cost", "certificate", "lower_bound")]


class Silent(LongPlanner):
    """A planner whose process does not answer."""

    started = ended = 0

    def _start(self) -> None:
        self._connection, self._theirs = Pipe()
        self.started += 1

    def close(self) -> None:
        self._connection.close()
        self.ended += 1


def test_a_process_answers_as_a_thread_does_also_after_it_was_killed_and_the_file_has_changed(
    bench: Bench, tmp_path: Path
) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(msgspec.yaml.encode(bench.arm.settings).decode())
    planner = LongPlanner(load(file), bench.weights)
    expected = proven(describe(ArmModel(bench.arm, "queries"), task(bench), nothing, lambda: False))
    assert proven(planner.plan(task(bench), nothing)) == expected
    planner.process.kill()
    file.write_text("name: other\n")
    answer = planner.plan(task(bench), nothing)
    assert isinstance(answer, Failed)
    assert "the process for long plans has failed" in answer.reason
    assert proven(planner.plan(task(bench), nothing)) == expected
    planner.close()
    assert planner.process.exitcode is not None


def test_a_plan_that_is_no_longer_wanted_ends_with_its_process(bench: Bench) -> None:
    planner = Silent(bench.arm, bench.weights)
    with pytest.raises(Abandoned):
        planner.plan(task(bench), abandoned)
    assert (planner.started, planner.ended) == (2, 1)


def test_a_process_that_does_not_answer_is_given_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    planner = Silent(bench.arm, bench.weights)
    monkeypatch.setattr(pool, "START", -60.0)
    answer = planner.plan(task(bench), nothing)
    assert isinstance(answer, Failed)
    assert "no answer after 0 s" in answer.reason
    assert (planner.started, planner.ended) == (2, 1)


def test_refusals_and_errors_are_answers(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    planner, far = PlanServer(bench.arm, bench.weights), task(bench)
    waypoint = msgspec.structs.replace(far.goal.message.waypoints[0], configuration=None, position=list(FAR))
    message = msgspec.structs.replace(far.goal.message, waypoints=[waypoint])
    answer = planner.answer(packed(far._replace(goal=far.goal._replace(message=message))))
    assert isinstance(answer, Refused)
    assert "out of reach" in str(answer.refusal)
    monkeypatch.setattr(pool, "build_scene", lambda *_: 1 / 0)
    failed = PlanServer(bench.arm, bench.weights).answer(packed(task(bench)))
    assert isinstance(failed, Failed)
    assert "ZeroDivisionError" in failed.reason


def test_a_process_of_another_version_refuses(bench: Bench) -> None:
    ours, theirs = Pipe()
    planner = PlanServer(bench.arm, bench.weights)
    serving = threading.Thread(target=answer_plans, args=(theirs, planner, "0.0.1"))
    serving.start()
    ours.send(packed(task(bench)))
    assert ours.poll(PATIENCE)
    answer = ours.recv()
    ours.close()
    serving.join()
    assert isinstance(answer, Failed)
    assert answer.reason.startswith("the daemon is hyperbit 0.0.1, installed is ")


def test_only_long_plans_go_to_processes(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    events: queue.SimpleQueue[Event] = queue.SimpleQueue()
    begun = threading.Event()

    class Endless(Silent):
        def plan(self, asked: DescribePlan, proceed: Any) -> Done:
            begun.set()
            while True:
                proceed()  # raises when the task is abandoned

    monkeypatch.setattr(pool, "LongPlanner", Endless)
    settings = msgspec.structs.replace(
        bench.arm.settings, planning=msgspec.structs.replace(bench.arm.settings.planning, workers=2)
    )
    workers = Workers(replace(bench.arm, settings=settings), bench.densities, bench.weights, events.put, print)
    workers.start(1, task(bench, 1.5))
    assert begun.wait(PATIENCE)
    workers.start(2, task(bench, 1.0))  # which another thread answers
    second = events.get(timeout=PATIENCE)
    assert isinstance(second, Answered)
    assert second.task == 2
    workers.abandon(1)
    assert events.get(timeout=PATIENCE) == Answered(1, tasks.Done(), True)
    workers.close(PATIENCE)
