"""The threads of the workers."""

import math
import queue
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import (
    BuildScene,
    BuildTables,
    Checked,
    CheckStages,
    DescribePlan,
    Deviations,
    Done,
    Failed,
    FollowSetpoint,
    ImprovePlan,
    Planned,
    PrepareSearch,
    Refused,
    SceneBuilt,
    Tables,
    Task,
)
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.pool import Workers
from tests.planning.workers.conftest import HOME, A, B, Bench
from tests.waiting import PATIENCE, eventually


class Core:
    def __init__(self, bench: Bench) -> None:
        self.events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self.fatal: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.refuses_events = False
        self.workers = Workers(bench.arm, bench.densities, bench.weights, self._post, self.fatal.put)

    def _post(self, event: Event) -> None:
        if self.refuses_events:
            raise RuntimeError("no more events")
        self.events.put(event)

    def next(self) -> Answered:
        event = self.events.get(timeout=PATIENCE)
        assert isinstance(event, Answered)
        return event


@pytest.fixture
def core(bench: Bench) -> Iterator[Core]:
    core = Core(bench)
    yield core
    core.workers.close()


class Door:
    """A plan that takes as long as the test wants."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.opened = threading.Event(), threading.Event()
        monkeypatch.setattr(computations, "plan_goal", self)

    def __call__(self, model: Any, task: Any, proceed: Any) -> Done:
        self.begun.set()
        while not self.opened.wait(0.01):
            proceed()
        return Done()


def test_a_goal_has_one_answer(core: Core, bench: Bench) -> None:
    core.workers.start(5, bench.task(A))
    answered = core.next()
    assert (answered.task, answered.last) == (5, True)
    assert isinstance(answered.answer, Planned)


def test_improvements_are_several_answers_and_the_last_is_marked(core: Core, bench: Bench) -> None:
    core.workers.start(1, bench.task(A, B))
    planned = core.next().answer
    assert isinstance(planned, Planned)
    core.workers.start(2, ImprovePlan(planned.plan, math.inf, True, bench.tables, bench.free))
    answers = [core.next()]
    while not answers[-1].last:
        answers.append(core.next())
    assert isinstance(answers[0].answer, Deviations)
    assert answers[-1] == Answered(2, Done(), True)


def test_each_kind_of_task_is_carried_out(core: Core, bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    tasks: list[Task] = [
        PrepareSearch(bench.basis()),
        FollowSetpoint(bench.basis(), tuple(bench.tip(*A)), 0.01),
        CheckStages(scene, bench.packed(*HOME), (bench.packed(*B),)),
        BuildScene(2, scene.keep_out.sent),
        BuildTables(2, bench.tables.locked),
    ]
    for number, task in enumerate(tasks):
        core.workers.start(number, task)
    answers = {answered.task: answered.answer for answered in (core.next() for _ in tasks)}
    assert [type(answers[number]).__name__ for number in range(5)] == [
        "Done",
        "Followed",
        Checked.__name__,
        SceneBuilt.__name__,
        Tables.__name__,
    ]


def test_a_refusal_has_its_reason_and_facts(core: Core, bench: Bench) -> None:
    core.workers.start(1, bench.task(A, message=bench.goal([9.0, 0.0])))
    answer = core.next().answer
    assert isinstance(answer, Refused)
    assert answer.reason.value == "out-of-reach"
    assert "is out of reach" in str(answer.refusal)


def test_an_exception_fails_its_task_only(core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(computations, "plan_goal", lambda *_: 1 / 0)
        core.workers.start(1, bench.task(A))
        assert core.next() == Answered(1, Failed("ZeroDivisionError: division by zero"), True)
    core.workers.start(2, bench.task(A))
    assert isinstance(core.next().answer, Planned)


def test_an_exception_between_two_answers_fails_the_task(
    core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> Iterator[Deviations]:
        yield Deviations(())
        raise ValueError("no more")

    monkeypatch.setattr(computations, "improve", breaks)
    core.workers.start(1, ImprovePlan(None, 0.0, True, bench.tables, bench.free))
    assert [core.next(), core.next()] == [
        Answered(1, Deviations(()), False),
        Answered(1, Failed("ValueError: no more"), True),
    ]


def test_an_abandoned_task_ends_and_a_waiting_one_does_not_begin(
    core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    door = Door(monkeypatch)
    core.workers.start(1, bench.task(A))
    core.workers.start(2, bench.task(A))
    assert door.begun.wait(PATIENCE)
    door.begun.clear()
    core.workers.abandon(2)
    core.workers.abandon(1)
    assert [core.next(), core.next()] == [Answered(1, Done(), True), Answered(2, Done(), True)]
    assert not door.begun.is_set()
    core.workers.abandon(1)  # too late, and harmless


def test_a_long_plan_delays_no_other_worker(core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    door = Door(monkeypatch)
    core.workers.start(1, bench.task(A))
    core.workers.start(2, CheckStages(bench.free, bench.packed(*HOME), (bench.packed(*B),)))
    assert core.next() == Answered(2, Checked(None), True)
    door.opened.set()
    assert core.next().task == 1


def test_a_query_ends_early_for_a_goal(core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    hurries, door = list[bool](), Door(monkeypatch)

    def describe(model: Any, task: Any, proceed: Any, hurry: Any) -> Done:
        hurries.append(hurry())
        return Done()

    monkeypatch.setattr(computations, "describe", describe)
    query = DescribePlan(bench.task(A), 1.0)
    core.workers.start(1, query)
    core.next()
    core.workers.start(2, bench.task(A))
    core.workers.start(3, query)
    assert core.next().task == 3
    assert hurries == [False, True]
    door.opened.set()
    assert core.next().task == 2


def test_at_the_end_all_tasks_are_answered(core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    Door(monkeypatch)
    for number in (1, 2):
        core.workers.start(number, bench.task(A))
    core.workers.close(PATIENCE)
    assert [core.next(), core.next()] == [Answered(1, Done(), True), Answered(2, Done(), True)]
    assert not any(thread.is_alive() for thread in core.workers.threads)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_ends_unexpectedly_ends_the_process(core: Core, bench: Bench) -> None:
    core.refuses_events = True
    core.workers.start(1, PrepareSearch(bench.basis()))
    assert "the planner's thread for goals has ended: RuntimeError" in core.fatal.get(timeout=PATIENCE)
    eventually(lambda: not core.workers.threads[0].is_alive())


def test_a_hurried_task_knows_it(core: Core, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()

    def plan(model: Any, task: Any, proceed: Any) -> Done:
        begun.set()
        while not proceed():
            pass
        return Done()

    monkeypatch.setattr(computations, "plan_goal", plan)
    core.workers.start(1, bench.task(A))
    assert begun.wait(PATIENCE)
    core.workers.hurry(1)
    assert core.next() == Answered(1, Done(), True)
