"""Set-points, collision checks, scenes and solvers, as functions of their tasks."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.motion.stages.pacing import Blocked
from hyperbit.controller.planning.core.tasks import (
    BuildScene,
    BuildTables,
    Checked,
    CheckStages,
    CheckStanding,
    FollowSetpoint,
)
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import (
    Abandoned,
    ArmModel,
    build_scene,
    build_tables,
    check_stages,
    check_standing,
    follow,
)
from hyperbit.controller.search.solver import Solver
from tests.planning.conftest import DOCUMENT, JOINT, unused_states
from tests.planning.workers.conftest import HOME, A, B, Bench, abandoned, nothing


def setpoint(
    bench: Bench, position: list[float], bias: tuple[float, ...] | None = None, **changes: Any
) -> FollowSetpoint:
    return FollowSetpoint(bench.basis(**changes), tuple(position), 0.01, bias)


@pytest.fixture
def setpoints(bench: Bench) -> ArmModel:
    return ArmModel(bench.arm, "setpoints")


def test_stages_lead_to_the_set_point(bench: Bench, setpoints: ArmModel) -> None:
    followed = follow(setpoints, setpoint(bench, bench.tip(*A)))
    assert (followed.note, followed.found) == ("", True)
    assert np.linalg.norm(bench.tip_of(followed.stages[-1]) - bench.tip(*A)) <= 0.005 + 1e-9
    among = follow(setpoints, setpoint(bench, bench.tip(*A), scene=bench.scene(([5.0, 5.0], 0.1))))
    assert among.stages


def test_the_arm_stays_where_no_switch_is_needed(bench: Bench, setpoints: ArmModel) -> None:
    followed = follow(setpoints, setpoint(bench, bench.tip(*HOME)))
    assert followed._replace(seconds=0.0) == ((), "", True, 0.0)


def test_a_set_point_out_of_reach_is_told_as_it_was_sent(bench: Bench, setpoints: ArmModel) -> None:
    followed = follow(setpoints, setpoint(bench, [5.0, 5.0], bias=(0.5, 0.0)))
    assert (followed.stages, followed.found) == ((), False)
    assert "out of reach at (5.5000, 5.0000): " in followed.note


def test_a_blocked_transition_is_told(bench: Bench, setpoints: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def blocked(*_: object) -> None:
        raise Blocked("module 2 is in it")

    monkeypatch.setattr(computations, "stages_to", blocked)
    followed = follow(setpoints, setpoint(bench, bench.tip(*A)))
    assert (followed.stages, followed.found) == ((), True)
    assert followed.note == ", but the transition to it is blocked: module 2 is in it"


def test_an_arm_whose_locks_change_stays(small: Any, small_densities: Any) -> None:
    bench = Bench(small, small_densities, bytes([0] + [255] * 11))
    followed = follow(ArmModel(small, "setpoints"), setpoint(bench, bench.tip(*A), start=bench.start(b"\1\0")))
    assert followed.note.startswith(", which is not possible now: the locked actuators are changing")


def test_the_first_collision_of_stages_is_told(bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    clear = CheckStages(scene, bench.packed(*HOME), (bench.packed(*HOME),))
    assert check_stages(clear, nothing) == Checked(None)
    touching = CheckStages(scene, bench.packed(*HOME), (bench.packed(*HOME), bench.packed(*B)))
    assert "is in disc regions[0]" in (check_stages(touching, nothing).collision or "")
    assert check_stages(touching._replace(scene=bench.free), nothing) == Checked(None)


def test_an_abandoned_check_ends(bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    task = CheckStages(scene, bench.packed(*HOME), (bench.packed(*A), bench.packed(*B)))
    with pytest.raises(Abandoned):
        check_stages(task, abandoned)


def test_results_of_checks_are_remembered(bench: Bench, monkeypatch: Any) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    task = CheckStages(scene, bench.packed(*HOME), (bench.packed(*B),))
    first = check_stages(task, nothing)
    monkeypatch.setattr("hyperbit.controller.obstacles.keep_out.sweep_of", None)
    assert check_stages(task, nothing) == first
    other = check_stages(task._replace(stages=(bench.packed(*A),)), nothing)
    assert (other.collision or "").startswith("a collision check failed")


def test_a_collision_at_rest_is_told(bench: Bench, make_bench: Callable[[dict[str, Any]], Bench]) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    assert check_standing(CheckStanding(scene, bench.packed(*HOME))) == Checked(None)
    assert "is in disc regions[0]" in (check_standing(CheckStanding(scene, bench.packed(*B))).collision or "")
    other = make_bench({**DOCUMENT, "modules": [JOINT]})
    unknown = bytes([unused_states(other.arm)])
    assert check_standing(CheckStanding(other.scene(([0.2, 0.0], 1.0)), unknown)) == Checked(None)


def test_a_scene_counts_obstacles_of_the_file_and_those_sent(make_bench: Callable[[dict[str, Any]], Bench]) -> None:
    disc = {"disc": {"centre": [5, 5], "radius": 0.1}}
    bench = make_bench({**DOCUMENT, "obstacles": [disc]})
    sent = bench.scene(([3.0, 3.0], 0.1)).keep_out.sent
    built = build_scene(bench.arm, BuildScene(4, sent))
    assert (built.scene.generation, built.scene.free, built.total, built.sent) == (4, False, 2, 1)
    assert not bench.free.free


def test_densities_of_the_file_serve_while_nothing_else_is_locked(bench: Bench) -> None:
    solvers: list[Solver] = list(bench.tables.solvers.values())
    assert all(solver.densities is bench.densities for solver in solvers)
    assert len({id(solver) for solver in solvers}) == 3
    assert bench.tables.locked == bytes([255] * 12)


def test_locked_actuators_reduce_the_arm(bench: Bench) -> None:
    locked = bytes([1] + [255] * 11)
    tables = build_tables(bench.arm, bench.densities, bench.weights, BuildTables(3, locked))
    assert (tables.generation, tables.locked) == (3, locked)
    assert tables.solvers["goals"].manipulator.states[0] == 4
    assert tables.solvers["goals"].densities is not bench.densities


def test_weights_count(bench: Bench) -> None:
    weights = bench.weights * 2
    tables = build_tables(bench.arm, bench.densities, weights, BuildTables(1, bench.tables.locked))
    assert tables.solvers["queries"].least_weight == pytest.approx(2.0)
