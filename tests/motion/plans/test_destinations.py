"""Waypoints that are configurations: decoded, planned without a search, unchanged by look-ahead."""

import json
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.motion.decoding.goal import GoalRules, parse, schedule
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities

FIRST, SECOND = "4646676700771206", "0000000000000001"


def scheduled(manipulator: Manipulator | None, *waypoints: dict[str, Any], **fields: Any) -> Trajectory:
    payload = json.dumps({"waypoints": [{"t": float(k), **point} for k, point in enumerate(waypoints)], **fields})
    return schedule(parse(payload.encode()), GoalRules(2, 0.002, 0.05, Pace(0.06), manipulator), 0.0)


@pytest.mark.parametrize(
    ("waypoint", "fields", "sentence"),
    [
        ({}, {}, r"waypoint 1, position: required, but missing; a `configuration` may"),
        (
            {"configuration": FIRST, "position": [0.5, 2.9]},
            {},
            r"waypoint 1, position: a configuration already determines",
        ),
        (
            {"configuration": FIRST, "orientation": 0.1},
            {},
            r"waypoint 1, orientation: a configuration already determines",
        ),
        ({"configuration": FIRST}, {"path_tolerance": 0.1}, r"waypoint 1, configuration: lines are followed by"),
        ({"configuration": "46"}, {}, r"waypoint 1, configuration: .* has 2 modules, the arm has 16"),
        ({"configuration": "9" * 16}, {}, r"waypoint 1, configuration: .* module 1 has states 0 to 7, not 9"),
        ({"configuration": "x" * 90_000}, {}, r"waypoint 1, configuration: configuration 'x+$"),
        ({"configuration": 46}, {}, r"waypoint 1, configuration: Expected `str \| null`"),
    ],
)
def test_an_invalid_waypoint_is_refused_by_field(
    manipulator: Manipulator, waypoint: dict[str, Any], fields: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(Refusal, match=sentence) as refused:
        scheduled(manipulator, waypoint, **fields)
    assert len(str(refused.value)) < 300


def test_a_planner_without_the_arm_refuses_configurations() -> None:
    with pytest.raises(Refusal, match=r"waypoint 1, configuration: only positions are accepted here"):
        scheduled(None, {"configuration": FIRST})


def test_a_plan_ends_in_the_configuration_of_the_waypoint(solver: Solver, manipulator: Manipulator) -> None:
    goal = scheduled(manipulator, {"configuration": FIRST}, {"position": [0.55, 2.9]}, {"configuration": SECOND})
    start = np.zeros(16, dtype=np.int64)
    found = PointByPoint(TransitionPlanner(solver, goal), "minimum-switch").plan(start)
    texts = [format_configuration(manipulator, solution.configuration) for solution in found.solutions]
    assert (texts[0], texts[2]) == (FIRST, SECOND)
    assert [solution.within_tolerance for solution in found.solutions] == [True] * 3
    assert goal.positions[0].tolist() == manipulator.tip(parse_configuration(manipulator, FIRST))[:2, 3].tolist()
    assert found.solutions[0].switches == manipulator.switches(start, parse_configuration(manipulator, FIRST))


def test_a_bias_moves_positions_but_not_configurations(manipulator: Manipulator) -> None:
    goal = scheduled(manipulator, {"configuration": FIRST}, {"position": [0.5, 2.9]})
    corrected = goal.corrected(np.array([0.1, 0.2]))
    assert corrected.positions.tolist() == [goal.positions[0].tolist(), pytest.approx([0.4, 2.7])]
    assert goal.positions[1].tolist() == [0.5, 2.9]


def test_looking_ahead_keeps_the_configuration_and_does_not_hold_another(
    solver: Solver, manipulator: Manipulator
) -> None:
    tip = manipulator.tip(parse_configuration(manipulator, FIRST))[:2, 3].tolist()
    near = {"position": [tip[0] + 1e-4, tip[1]]}
    goal = scheduled(manipulator, near, {"configuration": FIRST}, near)
    search = LabelSetting(solver, list(TrajectoryPoints(solver, goal)), np.zeros(16, dtype=np.int64))
    search.narrow(64)
    assert search.best.configurations is not None
    chosen = [format_configuration(manipulator, configuration) for configuration in search.best.configurations]
    assert chosen[1] == chosen[2] == FIRST


def test_a_configuration_that_a_locked_actuator_rules_out_is_refused(arm: Arm, densities: Densities) -> None:
    whole = arm.manipulator
    locked = np.full(len(whole.actuators), -1, dtype=np.int8)
    goal = scheduled(whole, {"configuration": FIRST})
    states = goal.fixed[0]
    locked[0] = 1 - states[0]
    reduced = Solver(lock_actuators(whole, locked), densities)
    start = reduced.manipulator.configuration(np.where(locked < 0, 0, locked))
    words = f"module 1 has no state in which left is {('contracted', 'extended')[states[0]]}"
    with pytest.raises(Refusal, match=rf"waypoint 1, configuration: a locked actuator: {words}$"):
        PointByPoint(TransitionPlanner(reduced, goal), "minimum-switch").plan(start)
    locked[0] = states[0]
    reduced = Solver(lock_actuators(whole, locked), densities)
    start = reduced.manipulator.configuration(np.where(locked < 0, 0, locked))
    found = PointByPoint(TransitionPlanner(reduced, goal), "minimum-switch").plan(start)
    assert reduced.manipulator.actuator_states(found.solutions[0].configuration).tolist() == states.tolist()
