"""Random trajectories of small arms, and their least cost by dynamic programming over all configurations."""

from typing import NamedTuple

import numpy as np

from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, spatial_arm
from tests.obstacles.dense import Disc, obstacles_of

SERVED = 1500  # configurations that serve a point, about


class Case(NamedTuple):
    solver: Solver
    trajectory: Trajectory
    start: np.ndarray
    clear: np.ndarray  # all clear configurations, shape (n, B)


def random_case(seed: int, most: int = 1 << 18) -> Case:
    """Returns a trajectory of an arm of 6 to 8 modules with at most `most` configurations: others are locked."""
    rng = np.random.default_rng(seed)
    planar, modules = bool(rng.integers(2)), int(rng.integers(6, 9))
    arm = paper_arm(modules) if planar else spatial_arm(modules)
    arm = locked(arm, rng, most >> int(rng.integers(6)))
    actuators = len(arm.actuators)
    weights = [None, rng.uniform(0.5, 3.0, actuators), rng.integers(1, 4, actuators)][int(rng.integers(3))]
    every, clearance = every_configuration(arm), None
    if rng.random() < 0.4:
        place = rng.uniform(-0.3, 0.3, arm.dimension)
        place[-1] = rng.uniform(0.4, 0.9)
        clearance = BodyClearance(arm, obstacles_of([Disc(tuple(place), 0.1)]), 0.01)
        clear = ~clearance.blocked(every)
        every, clearance = (every[clear], clearance) if clear.any() else (every, None)
    solver = Solver(arm, map_densities(arm, 0.1, 1 << 14), weights, clearance, list_whole=False)
    tips = arm.tips(every)
    count = int(rng.integers(3, 8))
    path = [int(rng.integers(len(every)))]
    for _ in range(count):
        target = tips[path[-1], :3, 3] + rng.normal(size=3) * rng.choice([0.02, 0.1, 0.3])
        path.append(int(np.argmin(np.linalg.norm(tips[:, :3, 3] - target, axis=1))))
    points = tips[path[1:], : arm.dimension, 3] + rng.normal(size=(count, arm.dimension)) * 0.003
    away = np.linalg.norm(tips[:, None, : arm.dimension, 3] - points, axis=2)
    tolerance = max(float(np.sort(away, axis=0)[min(SERVED, len(every) - 1)].min()) * rng.uniform(0.3, 1), 0.02)
    turns = np.where(rng.random(count) < 0.2, 0.4, np.inf)
    trajectory = through(np.arange(float(count)), points, tolerance, None, tips[path[1:], :3, :3], turns)
    return Case(solver, trajectory, every[path[0]], every)


def locked(arm: Manipulator, rng: np.random.Generator, most: int) -> Manipulator:
    """Returns the arm with as many actuators locked as leave it at most `most` configurations."""
    states, own = np.full(len(arm.actuators), -1, dtype=np.int8), arm.actuator_states(rng.integers(0, arm.states))
    reduced = arm
    for actuator in rng.permutation(len(states)):
        if np.prod(reduced.states.astype(float)) <= most:
            break
        states[actuator] = own[actuator]
        reduced = lock_actuators(arm, states)
    return reduced


def least_cost(case: Case) -> float:
    """Returns the least cost of a sequence, by dynamic programming; infinite if there is none."""
    solver, trajectory, start, every = case
    m, tips = solver.manipulator, solver.manipulator.tips(every)
    before, costs = start[None], np.zeros(1)
    for k in range(len(trajectory.times)):
        frame = np.eye(4)
        frame[: m.dimension, 3], frame[:3, :3] = trajectory.positions[k], trajectory.rotations[k]
        served = np.linalg.norm(tips[:, : m.dimension, 3] - trajectory.positions[k], axis=1) <= trajectory.tolerances[k]
        if trajectory.turns[k] < np.inf:
            served[served] = [angle_between(tip, frame) <= trajectory.turns[k] for tip in tips[served]]
        if k in trajectory.fixed:
            served = (every == m.configuration(trajectory.fixed[k])).all(axis=1)
        rows = every[served]
        if not len(rows):
            return float(np.inf)
        costs = np.array([float((costs + solver.cost(before, row)).min()) for row in rows])
        before = rows
    return float(costs.min())
