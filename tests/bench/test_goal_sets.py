"""The goal sets are complete and valid; a part of the proofs is repeated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hyperbit.controller.arm.arm import load
from hyperbit.controller.bench.arm import bench_arm
from hyperbit.controller.bench.checking import check
from hyperbit.controller.bench.goal_sets import FOLDER, SETS, by_arm, load_arm, read, sample_evenly
from tests.benchmarks.proofs.goal_sets import RECIPES, ROUNDING, again, drawn, same

DEPLOY = Path(__file__).parents[2] / "deploy"
COUNTS = {"paper": 1000} | dict.fromkeys(
    ("paper-poses", "planar16", "revolute24", "platform8", "motor12", "lattice", "obstacles"), 200
)


def test_every_set_is_complete_and_has_its_proofs():
    assert set(SETS) == set(COUNTS) == set(RECIPES) == {path.stem for path in (FOLDER / "sets").glob("*.csv")}
    for name, count in COUNTS.items():
        tasks = read(name)
        assert len(tasks) == count
        assert all(task.bound <= task.switches for task in tasks)
        assert sum(task.proven for task in tasks) == count
    assert sum(path.stat().st_size for path in (*FOLDER.glob("arms/*"), *FOLDER.glob("sets/*"))) < 1_000_000


@pytest.mark.parametrize("name", ["planar16", "revolute24", "platform8", "motor12"])
def test_the_arms_are_those_of_deploy(name):
    own, deployed = load_arm(name), load(DEPLOY / f"{name}.yaml")
    np.testing.assert_allclose(own.manipulator.frames, deployed.manipulator.frames, rtol=0.0, atol=ROUNDING)
    assert np.array_equal(own.manipulator.bits, deployed.manipulator.bits)
    assert own.tolerance == deployed.tolerance


@pytest.mark.parametrize("name", SETS)
def test_the_best_configurations_serve(name):
    arms = {arm: bench_arm(arm) for arm in by_arm(read(name))}
    for task in read(name):
        outcome = check(arms[task.arm], task, task.best, 0.0)
        assert (outcome.solved, outcome.switches) == (True, task.switches), outcome
        assert arms[task.arm].clearance.where(task.start) is None


@pytest.mark.parametrize("name", SETS)
def test_a_sample_is_proven_again(name):
    cheap = [task for task in read(name) if task.switches <= 5]
    for task in sample_evenly(cheap, 2):  # a proof takes up to 5 s
        again(task, 60.0)


@pytest.mark.parametrize("name", ["paper", "paper-poses", "obstacles"])
def test_a_set_has_the_goals_of_its_seed(name):
    draw, seed, counts = RECIPES[name]
    few = dict.fromkeys(counts, 2)
    tasks = [own[k] for own in by_arm(read(name)).values() for k in range(2)]
    for task, (arm, asked) in zip(tasks, drawn((draw, seed, few)), strict=True):
        assert same(task, arm, asked)


def test_few_goals_are_spread_over_all_arms():
    tasks = read("obstacles")
    assert set(by_arm(sample_evenly(tasks, 12))) == set(by_arm(tasks))
    assert sample_evenly(tasks, 500) == tasks


def test_the_last_bits_of_a_goal_may_differ_and_nothing_else():
    task = read("paper-poses")[0]
    assert task.angle is not None
    asked = (task.start, task.position, task.angle, task.tolerance, task.angle_tolerance, task.best)
    last_bits = tuple(np.nextafter(task.position, 9.0).tolist()), np.nextafter(task.angle, 9.0)
    assert same(task, task.arm, (task.start, *last_bits, *asked[3:]))
    assert not same(task, "motor12", asked)
    assert not same(task, task.arm, ((task.start + 1) % 8, *asked[1:]))
    assert not same(task, task.arm, (task.start, tuple(x + 1e-6 for x in task.position), *asked[2:]))
    assert not same(task, task.arm, (*asked[:2], task.angle + 1e-6, *asked[3:]))
    assert not same(task, task.arm, (*asked[:2], None, *asked[3:]))
    assert not same(task, task.arm, (*asked[:3], task.tolerance * 2, *asked[4:]))
