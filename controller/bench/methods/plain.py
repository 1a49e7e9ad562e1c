"""The simplest methods, for any arm and goal: coordinate descent and random search, as baselines."""

import math

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.methods import Solve
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.manipulator import Configuration

SAMPLES = 2_000

Array = NDArray[np.float64]


def excess(tips: Array, goal: Goal) -> Array:
    """Returns the excess of the errors of tips (n, 4, 4) over the tolerances, in tolerances, shape (n,)."""
    target, tolerance = goal.target, goal.tolerance or 1.0
    position = np.asarray(goal.position, dtype=float)
    misses = np.linalg.norm(tips[:, : len(position), 3] - position, axis=1) / tolerance
    result = np.maximum(misses - 1.0, 0.0)
    if goal.orientation is not None:
        turned = np.array([angle_between(tip, target) for tip in tips]) / (goal.angle_tolerance or math.pi)
        result = result + np.maximum(turned - 1.0, 0.0)
    return np.asarray(result)


def coordinate_descent(arm: BenchArm) -> Solve:
    """Prepares coordinate descent.

    The descent repeatedly takes the best state of the best module, until the tip is within the tolerances or no change
    of a single module improves it. Ties are broken by fewest switches.
    """
    m, clearance = arm.model.manipulator, arm.clearance
    modules, states = np.nonzero(np.arange(m.frames.shape[1]) < m.states[:, None])

    def solve(goal: Goal, start: Configuration) -> Configuration:
        own = start.copy()
        least = float(excess(m.tip(own)[None], goal)[0])
        while least > 0:
            chain = m.chain(own)
            # Frame of the tip in frame F_i, shape (B, 4, 4).
            after = np.linalg.inv(chain[1:]) @ chain[-1]
            tips = chain[modules] @ m.frames[modules, states] @ after[modules]
            misses = excess(tips, goal)
            others = np.tile(own, (len(modules), 1))
            others[np.arange(len(modules)), modules] = states
            misses[clearance.blocked(others)] = np.inf
            switches = (m.bits[modules, states] != m.bits[modules, start[modules]]).sum(axis=1)
            best = int(np.lexsort((switches, misses))[0])
            if misses[best] >= least:
                break
            own, least = others[best], float(misses[best])
        return own

    return solve


def random_search(arm: BenchArm) -> Solve:
    """Prepares random search.

    Each sample is the start with a random number of modules in random states. The search returns a solution of fewest
    switches, otherwise the nearest sample. The position of the goal is the seed, so that the answer does not depend on
    other goals.
    """
    m, clearance = arm.model.manipulator, arm.clearance

    def solve(goal: Goal, start: Configuration) -> Configuration:
        rng = np.random.default_rng(np.array(goal.position, dtype=float).view(np.uint64))
        drawn = rng.integers(0, m.states, (SAMPLES, len(start)))
        unchanged = rng.random((SAMPLES, len(start))) >= rng.random((SAMPLES, 1))
        every = np.where(unchanged, start, drawn)
        misses = excess(m.tips(every), goal)
        near = np.argsort(misses, kind="stable")[:100]
        near = near[~clearance.blocked(every[near])]
        if len(near) == 0:
            return start
        solutions = near[misses[near] == 0]
        if len(solutions) == 0:
            return np.asarray(every[near[0]])
        return np.asarray(min(every[solutions], key=lambda own: m.switches(start, own)))

    return solve
