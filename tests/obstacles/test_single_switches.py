"""The kernel for single switches proves no more than the swept check, and hardly less."""

import numpy as np
import pytest

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.frames import spatial
from hyperbit.controller.manipulator.joints import prismatic
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.single_switches import arm_switches, place_arm, switch_is_clear, switch_scratch
from hyperbit.controller.obstacles.sweep import Sweep
from tests.benchmarks.harness import DEPLOY
from tests.benchmarks.motion.obstacle_transitions import scene
from tests.obstacles.dense import obstacles_of

ALIKE = 0.98  # least share of switches on which both agree


@pytest.mark.parametrize("self_collision", [False, True])
@pytest.mark.parametrize("name", ["planar16", "platform8", "revolute24"])
def test_it_agrees_with_the_swept_check_or_is_stricter(name, self_collision):
    manipulator, rng = load(DEPLOY / f"{name}.yaml").manipulator, np.random.default_rng(5)
    switches, alike = arm_switches(manipulator), list[bool]()
    for _ in range(4):
        obstacles = obstacles_of(scene(manipulator, rng))
        clearance = BodyClearance(manipulator, obstacles, 0.02, self_collision=self_collision)
        sweep, scratch = Sweep(clearance), switch_scratch(clearance, len(manipulator.modules))
        some = rng.integers(0, manipulator.states, (200, len(manipulator.states)))
        for configuration in some[~clearance.blocked(some)][:3]:
            states = manipulator.actuator_states(configuration)
            place_arm(switches, clearance.arm_bodies, configuration, scratch)
            for actuator in range(len(states)):
                here = clearance.arm_bodies, clearance.surroundings, configuration, actuator, scratch
                clear = switch_is_clear(switches, *here)
                proven = sweep.first_collision(states, np.array([actuator])) is None
                assert proven or not clear
                assert not (proven and scratch.collided[0])
                alike.append(clear == proven)
    assert len(alike) > 100
    assert np.mean(alike) >= ALIKE


def test_an_arm_with_a_joint_that_cannot_switch_has_the_switches_of_the_others():
    modules = [
        prismatic([0, 1, 0], [0.0, 0.05], spatial([0, 0.1, 0])),
        prismatic([0, 1, 0], [0.1, 0.2], spatial([0, 0.1, 0])),
    ]
    reduced = lock_actuators(Manipulator(modules, np.eye(4)), np.array([0, -1]))
    assert (arm_switches(reduced).following >= 0).sum(axis=(1, 2)).tolist() == [0, 2]


def test_a_switch_to_no_state_is_none():
    manipulator = load(DEPLOY / "planar16.yaml").manipulator
    following, rows = arm_switches(manipulator).following, arm_switches(manipulator).rows
    for i, module in enumerate(manipulator.modules):
        for k, code in enumerate(module.bits):
            for a in range(len(code)):
                other = np.flatnonzero((module.bits != code).sum(axis=1) == (module.bits[:, a] != code[a]))
                expected = [n for n in other if module.bits[n, a] != code[a]]
                assert following[i, k, a] == (expected[0] if expected else -1)
                assert (rows[i, k, a] >= 0) == bool(expected)
