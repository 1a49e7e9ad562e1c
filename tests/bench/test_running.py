"""The benchmark's rating of correct, wrong and invalid answers."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

import hyperbit as hb
from hyperbit.controller.bench.arm import BenchArm, bench_arm
from hyperbit.controller.bench.goal_sets import Task, read, sample_evenly
from hyperbit.controller.bench.methods import METHODS, find_method, two_list
from hyperbit.controller.bench.running import Row, run
from tests.arms import paper_arm

TASKS = sample_evenly(read("lattice"), 10)
BEST = {(task.arm, task.start.tobytes(), task.position): task for task in TASKS}


def known(arm: BenchArm, goal: hb.Goal, start: np.ndarray) -> Task:
    return BEST[arm.name, start.tobytes(), tuple(goal.position)]


def ran(answer) -> Row:
    return run("mine", lambda arm: lambda goal, start: answer(known(arm, goal, start)), TASKS, 60.0)


def test_the_best_configurations_solve_all_without_a_switch_above():
    row = ran(lambda task: task.best)
    assert (row.goals, row.solved, row.fewest, row.above, row.above_most) == (10, 10, 10, 0.0, 0)
    assert (row.proven, row.wrong_certificates, row.errors, row.impossible) == (0, 0, {}, 0)


def test_true_certificates_count_as_proven():
    row = ran(lambda task: SimpleNamespace(configuration=task.best, certificate="optimal", bound=task.switches))
    assert (row.proven, row.wrong_certificates) == (10, 0)


@pytest.mark.parametrize(
    "claim",
    [
        {"certificate": "unreachable"},
        {"bound": 1000},
        {"bound": np.inf},
        {"bound": "many"},
        {"bound": np.nan},
        {"certificate": "optimal", "bound": 99.0},
    ],
)
def test_a_wrong_certificate_is_counted_and_named(claim):
    row = ran(lambda task: SimpleNamespace(configuration=task.best, **claim))
    assert (row.solved, row.proven, row.wrong_certificates) == (10, 0, 10)
    assert row.examples[0].startswith("goal 1: claims")


def test_optimal_is_wrong_of_an_answer_that_misses_or_switches_more():
    row = ran(lambda task: SimpleNamespace(configuration=task.start, certificate="optimal"))
    assert row.wrong_certificates == 10 - row.solved
    prepare = find_method(METHODS["pop"].target)

    def boasting(arm):
        solve = prepare(arm)
        return lambda goal, start: SimpleNamespace(
            configuration=solve(goal, start).configuration, certificate="optimal"
        )

    row = run("boasting", boasting, TASKS, 60.0)
    assert row.wrong_certificates == 10 - row.fewest > 0


class Hostile:
    @property
    def configuration(self):
        raise RuntimeError("no")

    def __array__(self, *given, **more):
        raise RuntimeError("no")


@pytest.mark.parametrize(
    "answer",
    [
        "12x",
        "",
        7,
        [],
        [[0, 1], [2]],
        {},
        object(),
        Hostile(),
        np.zeros((3, 3), dtype=int),
        np.zeros(10_000, dtype=int),
        SimpleNamespace(configuration=Hostile()),
        SimpleNamespace(configuration="0"),
    ],
)
def test_nonsense_is_counted_and_named(answer):
    row = ran(lambda task: answer)
    assert (row.solved, row.errors) == (0, {"no configuration": 10})
    assert row.examples[0].startswith("goal 1: no configuration")


@pytest.mark.parametrize("change", [lambda own: own + 0.0, lambda own: own + 100, lambda own: own - 100])
def test_numbers_that_are_no_states_are_nonsense(change):
    assert ran(lambda task: change(task.best)).errors == {"no configuration": 10}


def test_nothing_found_is_a_miss():
    for answer in (None, SimpleNamespace(configuration=None)):
        row = ran(lambda task, answer=answer: answer)
        assert (row.solved, row.missed, row.errors) == (0, 10, {})


def test_text_is_taken_as_the_library_writes_configurations():
    row = run("text", lambda arm: lambda goal, start: arm.arm.format(known(arm, goal, start).best), TASKS, 60.0)
    assert row.solved == 10


def test_exceptions_are_counted_and_named():
    def failing(task):
        raise (SystemExit if task.switches % 2 else ZeroDivisionError)("so it is")

    row = ran(failing)
    assert sum(row.errors.values()) == 10
    assert set(row.errors) <= {"raised SystemExit", "raised ZeroDivisionError"}
    assert "so it is" in row.examples[0]


def broken(arm):
    raise KeyError("tables")


def test_a_method_that_cannot_be_prepared_fails_all_goals():
    assert run("broken", broken, TASKS, 60.0).errors == {"raised KeyError": 10}
    assert run("none", lambda arm: None, TASKS, 60.0).errors == {"no function": 10}


def test_goals_that_a_method_does_not_support_are_left_out():
    def planar(arm):
        if arm.base.shape != (4, 4) or arm.name in ("lattice-space", "lattice-boxes"):
            raise NotImplementedError
        return lambda goal, start: known(arm, goal, start).best

    row = run("planar", planar, TASKS, 60.0)
    assert (row.goals, row.left_out, row.solved, row.errors) == (6, 4, 6, {})


def test_a_method_cannot_change_the_task():
    before = [(task.start.copy(), task.best.copy()) for task in TASKS]

    def vandal(arm):
        for values in (arm.frames, arm.base, arm.bits, arm.states):
            values[:] = 0

        def solve(goal, start):
            start[:] = 0
            return start

        return solve

    run("vandal", vandal, TASKS, 60.0)
    assert all(np.array_equal(task.start, b[0]) for task, b in zip(TASKS, before, strict=True))
    assert ran(lambda task: task.best).solved == 10


def test_a_method_that_takes_too_long_is_ended():
    def solve(goal, start):
        while True:
            time.sleep(0.001)

    row = run("slow", lambda arm: solve, TASKS[:2], 0.05)
    assert row.errors == {"took too long": 2}


def test_the_arm_given_to_methods_is_the_one_that_judges():
    arm = bench_arm("planar16-room")
    assert [type(o).__name__ for o in arm.obstacles] == ["HalfPlane"] * 3 + ["Box"]
    own = arm.arm.sample(1)[0]
    tip = arm.base
    for frame in arm.frames[np.arange(16), own]:
        tip = tip @ frame
    assert np.allclose(tip, arm.arm.frame(own))
    assert len(arm.bodies) == 16
    assert arm.margin > 0.02


@pytest.mark.parametrize("name", METHODS)
def test_each_method_of_the_benchmark_runs(name):
    tasks = [read(own)[0] for own in ("revolute24", "lattice", "paper-poses")] + sample_evenly(read("obstacles"), 2)[1:]
    tasks += read("planar16")[:1]
    row = run(name, find_method(METHODS[name].target), tasks, 60.0)
    assert (row.goals + row.left_out, row.errors, row.impossible, row.wrong_certificates) == (5, {}, 0, 0)
    assert row.goals >= 1


def test_an_answer_does_not_depend_on_other_goals():
    task, *others = [task for task in read("lattice") if task.arm == TASKS[0].arm][:3]
    goal, arm = hb.Goal(task.position, task.angle, task.tolerance), bench_arm(task.arm)
    prepare = find_method(METHODS["meet-in-the-middle"].target)
    first, later = prepare(arm), prepare(arm)
    for other in others:
        later(hb.Goal(other.position, other.angle, other.tolerance), other.start)
    assert np.array_equal(first(goal, task.start), later(goal, task.start))


def test_the_list_of_a_half_is_complete_without_duplicates():
    arm = paper_arm(6)
    problem, previous = two_list.prepare(arm, None, 3), np.array([1, 7, 0, 2, 5, 4])
    problem.upper.list((0.0, 0.0), problem.arm.costs(previous), 3)
    found = set()
    for row in range(problem.upper.count):
        own = previous.copy()
        problem.upper.write(problem.upper.codes[row], own)
        assert arm.switches(own, previous) == problem.upper.prices[row] <= 3
        found.add(tuple(own))
    assert len(found) == problem.upper.count == 1 + 9 + 36 + 84
