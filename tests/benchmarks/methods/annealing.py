"""Simulated annealing over the actuators: Kirkpatrick, Gelatt and Vecchi 1983, "Optimization by simulated annealing".

A move switches one actuator. What is minimised is the error outside the tolerance, then switches: both in one sum, for
a chain needs a way through the one to the other. It starts from the previous configuration; the temperature falls
geometrically over a number of moves that is measured to fill the time given. A move is judged by one motion of a point,
as the goal from below and the tip from above are kept for every frame and brought up to date only where one is taken.
"""

import time
from dataclasses import dataclass

import numpy as np
from numba import njit

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.workspace.densities import Densities
from tests.benchmarks.methods.planar import Array, Index, Planar, moved, planar, tips_above

# In switches. An error of ERROR_OF_A_SWITCH beyond the tolerance is as bad as one switch. Hotter, colder and smaller
# ones were tried on the paper's arm: what came within the tolerance more often switched more.
HOT, COLD, ERROR_OF_A_SWITCH = 4.0, 0.8, 0.01
LEAST_MOVES = 100


@dataclass(frozen=True, eq=False)
class Problem:
    """The arm, for each state the one that each switch leads to (B, K, A), -1 where none, and the number of moves."""

    arm: Planar
    switched: Index
    moves: int


def prepare(manipulator: Manipulator, densities: Densities | None, seconds: float) -> Problem:
    arm = planar(manipulator)
    bits = manipulator.bits.astype(int)
    switched = np.full(bits.shape, -1)
    for i, j in np.ndindex(bits.shape[:2]):
        for to in range(arm.states[i]):
            if j < arm.states[i] and arm.differing[i, j, to] == 1:
                switched[i, j, np.argmax(bits[i, j] != bits[i, to])] = to
    home = np.zeros(len(arm.states), dtype=np.int64)
    trial, rates = Problem(arm, switched, 20_000), []
    for goal in manipulator.tips(manipulator.states - 1 - home[None] - np.arange(3)[:, None])[:, :2, 3]:
        began = time.perf_counter()
        solve(trial, np.ascontiguousarray(goal), home, 1e-3)
        rates.append((time.perf_counter() - began) / trial.moves)
    return Problem(arm, switched, max(int(seconds / np.median(rates)), LEAST_MOVES))


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    arm, best = problem.arm, np.array(previous)
    anneal(
        goal,
        arm.up,
        arm.down,
        arm.differing,
        problem.switched,
        tolerance,
        problem.moves,
        HOT,
        COLD,
        ERROR_OF_A_SWITCH,
        best,
    )
    return best


@njit(
    "void(f8[::1], f8[:,:,::1], f8[:,:,::1], i8[:,:,::1], i8[:,:,::1], f8, i8, f8, f8, f8, i8[::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def anneal(
    goal: Array,
    up: Array,
    down: Array,
    differing: Index,
    switched: Index,
    tolerance: float,
    moves: int,
    hot: float,
    cold: float,
    error_of_a_switch: float,
    best: Index,
) -> None:
    """Improves `best`, the configuration of before: within the tolerance the fewest switches, else the nearest."""
    np.random.seed(0)  # noqa: NPY002, numba's own: a goal is answered the same way every time
    count, actuators = len(best), switched.shape[2]
    previous, own = best.copy(), best.copy()
    goals, tips = np.empty((count + 1, 2)), np.empty((count + 1, 2))
    goals[0] = goal
    for i in range(count):
        goals[i + 1, 0], goals[i + 1, 1] = moved(down[i, own[i]], goals[i, 0], goals[i, 1])
    tips_above(up, own, tips)
    nearest = np.sqrt((goals[0, 0] - tips[0, 0]) ** 2 + (goals[0, 1] - tips[0, 1]) ** 2)
    if nearest <= tolerance:
        return
    value, switches, fewest = (nearest - tolerance) / error_of_a_switch, 0, 1 << 30
    temperature, fall = hot, (cold / hot) ** (1 / moves)
    for _ in range(moves):
        temperature *= fall
        i, a = np.random.randint(count), np.random.randint(actuators)  # noqa: NPY002
        j = switched[i, own[i], a]
        if j < 0:
            continue
        x, y = moved(down[i, j], goals[i, 0], goals[i, 1])
        error = np.sqrt((x - tips[i + 1, 0]) ** 2 + (y - tips[i + 1, 1]) ** 2)
        number = switches - differing[i, previous[i], own[i]] + differing[i, previous[i], j]
        new = number + max(error - tolerance, 0.0) / error_of_a_switch
        if new > value and np.random.random() >= np.exp((value - new) / temperature):  # noqa: NPY002
            continue
        own[i], value, switches = j, new, number
        for k in range(i, count):
            goals[k + 1, 0], goals[k + 1, 1] = moved(down[k, own[k]], goals[k, 0], goals[k, 1])
        for k in range(i, -1, -1):
            tips[k, 0], tips[k, 1] = moved(up[k, own[k]], tips[k + 1, 0], tips[k + 1, 1])
        if error <= tolerance:
            if number < fewest:
                fewest, nearest = number, error
                best[:] = own
        elif error < nearest:
            nearest = error
            best[:] = own
