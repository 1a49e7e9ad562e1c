"""Random small arms, listed whole and not, compared with brute force: every answer and certificate.

python -m tests.benchmarks.proofs.small_arms

Arms have 6 to 14 actuators with weights from 0.01 to 5, some locked, some among obstacles. Half of the goals are one
float inside, on or outside the tolerance of a configuration. Brute force is numpy's own; it uses from the product only
frames and actuator states of the modules. A false answer ends the program.
"""

import time
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.frames import planar, spatial, turned
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.manipulator.platform import platform
from hyperbit.controller.manipulator.vgt import vgt
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.plans.whole import TipGoals, plan_whole, unhurried
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import sphere
from hyperbit.controller.search.method import MINIMUM_SWITCH
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import CommandLine
from tests.benchmarks.proofs.acceptance import check_of, clear

Array = NDArray[np.float64]
Random = np.random.Generator

FEWEST, MOST = 6, 14  # actuators
GOALS = 3  # of each arm, beside its trajectory
SERVED = 1000  # configurations that serve a goal, at most: brute force compares each with each
APART = 1e-9  # [rad] of each configuration's angle from the tolerance; positions are compared exactly
KINDS = ("trusses", "platforms", "revolute", "mixed")


class Goal(NamedTuple):
    frame: Array  # shape (4, 4)
    tolerance: float
    turn: float  # tolerance of the angle [rad]; infinite: any


class SmallArm:
    """A random arm with goals, and brute force over all its configurations."""

    def __init__(self, seed: int) -> None:
        self._rng = rng = np.random.default_rng(seed)
        self.kind = KINDS[seed % len(KINDS)]
        self.arm = m = drawn_arm(self.kind, rng)
        self.weights = rng.uniform(0.01, 5.0, len(m.actuators)) if rng.random() < 0.7 else np.ones(len(m.actuators))
        self.every = np.array(list(np.ndindex(*m.states)))
        self.bits = np.concatenate([module.bits[self.every[:, i]] for i, module in enumerate(m.modules)], axis=1)
        self.tips = products(m.base, [module.frames[self.every[:, i]] for i, module in enumerate(m.modules)])
        self.clear, self.clearance = np.ones(len(self.every), bool), None
        if m.planar and rng.random() < 0.4:
            place = self.tips[rng.integers(len(self.every)), :3, 3] * rng.uniform(0.3, 0.9)
            self.clearance = BodyClearance(m, sphere("ball", place[:2], 0.15 * m.length), 0.01 * m.length)
            check = check_of(self.clearance, np.eye(4), 1.0, np.inf)
            self.clear = np.array([clear(check, row) for row in self.every])
        self.start = self.every[rng.integers(len(self.every))]
        self.goals = [self._goal(reached=False) for _ in range(GOALS)]
        self.path = [self._goal(reached=True) for _ in range(rng.integers(2, 6))]

    def _goal(self, reached: bool) -> Goal:
        """Draws a goal; `reached`: that a configuration serves, obstacles aside."""
        rng, m = self._rng, self.arm
        while True:
            end, size = self.tips[rng.integers(len(self.every))], m.dimension
            frame, turn, tolerance = end.copy(), np.inf, m.length * 10 ** rng.uniform(-3, -1)
            if rng.random() < 0.5:
                frame[rng.integers(size), 3] += tolerance * rng.choice((-1.0, 1.0))
                away = float(distances(end[None], frame)[0])
                tolerance = float(np.nextafter(away, away + rng.integers(-1, 2)))
            else:
                frame[:size, 3] += rng.normal(size=size) * tolerance / 2
            if rng.random() < 0.25:
                frame[:3, :3] = (end @ turned((0, 0, 1) if m.planar else rng.normal(size=3), rng.normal(0, 0.2)))[
                    :3, :3
                ]
                turn = float(rng.uniform(0.05, 0.6))
            goal = Goal(frame, tolerance, turn)
            sure = turn == np.inf or np.abs(angles(self.tips, frame) - turn).min() > APART
            if sure and np.count_nonzero(self.served(goal)) in range(int(reached), SERVED):
                return goal

    def served(self, goal: Goal) -> NDArray[np.bool_]:
        """Returns which configurations are within the tolerances."""
        near: NDArray[np.bool_] = distances(self.tips, goal.frame) <= goal.tolerance
        return near if goal.turn == np.inf else near & (angles(self.tips, goal.frame) <= goal.turn)

    def costs(self, first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Array:
        """Returns the costs (n, m) between configurations, given as masks."""
        x, y = self.bits[first].astype(float), self.bits[second].astype(float)
        return np.asarray((x * self.weights) @ (1 - y).T + ((1 - x) * self.weights) @ y.T)

    def least(self, goals: list[Goal], obstacles: bool = True) -> float:
        """Returns the least cost of a sequence through goals; infinite if there is none."""
        before = (self.every == self.start).all(axis=1)
        costs = np.zeros(1)
        for goal in goals:
            own = self.served(goal) & (self.clear | (not obstacles))
            costs = (costs[:, None] + self.costs(before, own)).min(axis=0, initial=np.inf)
            before = own
        return float(costs.min(initial=np.inf))

    def solver(self, list_whole: bool, obstacles: bool = True) -> Solver:
        densities = map_densities(self.arm, self.arm.length / 20 + 1e-6, 2000)
        clearance = self.clearance if obstacles else None
        solver = Solver(self.arm, densities, self.weights, clearance, list_whole=list_whole)
        solver.prepare()
        return solver


def drawn_arm(kind: str, rng: Random) -> Manipulator:
    modules, space = list[Module](), kind in ("platforms", "mixed") and bool(rng.random() < 0.5)
    most, total = int(rng.integers(FEWEST, MOST + 1)), 0
    for module in (drawn_module(kind, rng, space) for _ in range(MOST)):
        if total + len(module.actuators) <= most:
            modules.append(module)
            total += len(module.actuators)
    arm = Manipulator(modules)
    held = np.where(rng.random(total) < 0.15, arm.actuator_states(rng.integers(0, arm.states)), -1)
    return lock_actuators(arm, held.astype(np.int8)) if rng.random() < 0.25 else arm


def drawn_module(kind: str, rng: Random, space: bool) -> Module:
    if kind == "trusses":
        return vgt("BC" if rng.random() < 0.5 else "AD", 0.2, *[(0.2, float(rng.uniform(0.21, 0.26)))] * 3)
    if kind == "platforms":
        return small_platform(space)
    step, axis = float(rng.choice((0.1, 0.25, 0.3))), np.eye(3)[2 if not space else rng.integers(3)]
    if kind == "mixed" and rng.random() < 0.5:
        return prismatic(np.eye(3)[rng.integers(3 if space else 2)], (0.0, step), np.eye(4))
    values = rng.choice((-np.pi / 2, -0.4, -0.2, 0.0, 0.3, np.pi / 2), rng.choice((2, 4)), replace=False)
    return revolute(axis, values, spatial((step, 0.0, 0.0)) if space else planar(step, 0.0))


@cache  # its displacements take a second
def small_platform(space: bool) -> Module:
    corners = np.radians([90.0, 210.0, 330.0])
    ring = 0.1 * np.column_stack([np.cos(corners), np.sin(corners), np.zeros(3)])
    base, top = [(-0.1, 0.0), (0.0, 0.0), (0.1, 0.0)], [(-0.1, 0.0), (-0.1, 0.0), (0.1, 0.0)]
    return platform(ring, ring, (0.2, 0.24)) if space else platform(base, top, (0.2, 0.24))


def products(base: Array, frames: list[Array]) -> Array:
    """Returns the products (n, 4, 4) of a base and frames (n, 4, 4), each sum in the order of its terms."""
    total = np.broadcast_to(base, frames[0].shape)
    for own in frames:
        terms = [total[:, :, c, None] * own[:, c, None, :] for c in range(4)]
        total = ((terms[0] + terms[1]) + terms[2]) + terms[3]
    return total


def distances(tips: Array, goal: Array) -> Array:
    x, y, z = (tips[:, a, 3] - goal[a, 3] for a in range(3))
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def angles(tips: Array, goal: Array) -> Array:
    """Returns the angles [rad] between the orientations of tips (n, 4, 4) and a goal."""
    turns = np.einsum("nba,bc->nac", tips[:, :3, :3], goal[:3, :3])
    sines = np.array(
        [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]]
    )
    return np.asarray(np.arctan2(np.linalg.norm(sines, axis=0), np.trace(turns, axis1=1, axis2=2) - 1))


class Answer(NamedTuple):
    certificate: str
    seconds: float


def judged(certificate: str, cost: float, bound: float, least: float, proven: bool) -> None:
    """Raises AssertionError if a certificate is false, or none although a proof is due."""
    same = 1e-9 * max(least, 1.0) if least < np.inf else 0.0
    assert cost >= least - same, f"costs {cost}, which is less than any: {least}"
    if certificate == "optimal":
        assert cost <= least + same, f"optimal {cost}, least {least}"
    elif certificate == "unreachable":
        assert least == np.inf, f"unreachable, but {least} is the least"
    else:
        assert not proven, f"{certificate}, not proven"
    assert bound <= least + same, f"bound {bound}, least {least}"


def solved(small: SmallArm, list_whole: bool, seconds: float) -> list[Answer]:
    """Solves all goals, and checks each answer."""
    solver, answers = small.solver(list_whole), list[Answer]()
    for goal in small.goals:
        asked = goal.frame if goal.turn < np.inf else goal.frame[: small.arm.dimension, 3]
        target = solver.target(asked, goal.tolerance, goal.turn)
        began = time.perf_counter()
        found = solver.solve(target, small.start, timeout=seconds)
        answers.append(Answer(found.certificate, time.perf_counter() - began))
        own = (small.every == found.configuration).all(axis=1)
        assert found.within_tolerance == bool((small.served(goal) & small.clear & own).any())
        cost = found.cost if found.within_tolerance else np.inf
        judged(found.certificate, cost, found.bound, small.least([goal]), list_whole)
        if list_whole and not found.within_tolerance and goal.turn == np.inf and small.clear.any():
            assert found.error <= distances(small.tips[small.clear], goal.frame).min() + 1e-12
    return answers


def followed(small: SmallArm, list_whole: bool, seconds: float) -> Answer:
    """Follows the trajectory without obstacles, and checks the path and its certificate."""
    solver, size, path = small.solver(list_whole, obstacles=False), small.arm.dimension, small.path
    goals = TipGoals(
        np.array([goal.frame[:size, 3] for goal in path]),
        np.array([goal.tolerance for goal in path]),
        np.array([goal.frame[:3, :3] for goal in path]),
        np.array([goal.turn for goal in path]),
    )
    pace = Pace(0.1)
    planner = TransitionPlanner(solver, unhurried(goals, pace), pace)
    began = time.perf_counter()
    found = plan_whole(planner, small.start, MINIMUM_SWITCH, seconds)
    taken = time.perf_counter() - began
    for goal, solution in zip(path, found.solutions, strict=True):
        assert (small.served(goal) & (small.every == solution.configuration).all(axis=1)).any()
    judged(found.certificate, found.cost, found.bound, small.least(path, obstacles=False), list_whole)
    return Answer(found.certificate, taken)


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--arms", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=0.05, help="for a goal")
    parser.add_argument("--whole", type=float, default=1.0, help="[s] for a trajectory")
    given = parser.parse()
    smalls = [SmallArm(seed) for seed in range(given.arms)]
    for list_whole in (True, False):
        goals, paths = list[Answer](), list[Answer]()
        for seed, small in enumerate(smalls):
            try:
                goals += solved(small, list_whole, given.seconds)
                paths.append(followed(small, list_whole, given.whole))
            except AssertionError as error:
                raise SystemExit(f"seed {seed}, listed whole {list_whole}: {error}") from None
        for what, answers in (("goals", goals), ("trajectories", paths)):
            proven = np.mean([answer.certificate in ("optimal", "unreachable") for answer in answers])
            missed = np.mean([answer.certificate == "unreachable" for answer in answers])
            times = 1e3 * np.array([answer.seconds for answer in answers])
            shares = f"{proven:.1%} proven, {missed:.1%} out of reach"
            median, most, worst = np.quantile(times, (0.5, 0.99, 1.0))
            spent = f"median {median:.2f} ms, 99 % {most:.1f} ms, worst {worst:.1f} ms"
            print(f"{len(answers)} {what}, listed whole {list_whole}: {shares}; {spent}", flush=True)


if __name__ == "__main__":
    main()
