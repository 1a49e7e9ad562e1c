"""Simulated annealing over the actuators: Kirkpatrick, Gelatt and Vecchi 1983, "Optimization by simulated annealing".

A move switches one actuator. The objective is the number of switches plus the weighted error outside the tolerance, so
that a run can cross configurations outside the tolerance. Each run starts from the previous configuration with
geometric cooling. Runs repeat until the first solution or until the time is over; the best configuration counts. A move
costs one motion of a point: the goal and the tip are stored in each frame, and updated only after accepted moves.
"""

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from controller.bench.methods.planar import Array, Index, Planar, moved, planar, tips_above
from controller.bench.methods.two_list import NONE
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.workspace.densities import Densities


class Schedule(NamedTuple):
    """Schedule of a run: number of moves, first and last temperature [switches], error that weighs as one switch."""

    moves: int
    hot: float
    cold: float
    error_of_a_switch: float


# The best schedules tried on the paper's arm. FEW, restarted, gave the fewest switches in 30 ms and in 300 ms. SOON was
# the first within the tolerance for 99 % of the goals.
FEW, SOON = Schedule(10_000, 2.0, 0.2, 0.03), Schedule(100_000, 4.0, 0.8, 0.01)
SEED = 0x9E3779B97F4A7C15  # the answer to a goal is reproducible


@dataclass(frozen=True, eq=False)
class Problem:
    """Tables of an arm.

    Attributes:
        arm: the arm.
        switched: state after the switch of each actuator, shape (B, K, A); -1 if there is none.
        seconds: time for a goal [s].
        first: whether the search ends with the first configuration within the tolerance.
    """

    arm: Planar
    switched: Index
    seconds: float
    first: bool


def prepare(manipulator: Manipulator, densities: Densities | None, seconds: float, first: bool = False) -> Problem:
    """Returns the tables of an arm."""
    arm = planar(manipulator)
    bits = manipulator.bits.astype(int)
    switched = np.full(bits.shape, -1)
    for i, j in np.ndindex(bits.shape[:2]):
        for to in range(arm.states[i]):
            if j < arm.states[i] and arm.differing[i, j, to] == 1:
                switched[i, j, np.argmax(bits[i, j] != bits[i, to])] = to
    return Problem(arm, switched, seconds, first)


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    until, arm, best = time.perf_counter() + problem.seconds, problem.arm, np.array(previous)
    chain = arm.up, arm.down, arm.differing, problem.switched
    schedule = SOON if problem.first else FEW
    random, fewest, nearest = np.uint64(SEED), NONE, np.inf
    while True:
        random, fewest, nearest = anneal(
            goal, previous, *chain, tolerance, problem.first, *schedule, random, fewest, nearest, best
        )
        if (problem.first and nearest <= tolerance) or fewest == 0 or time.perf_counter() >= until:
            return best


@njit("u8(u8)", cache=True, nogil=True, inline="always")
def drawn(state: np.uint64) -> np.uint64:
    """Returns the next state of Marsaglia's xorshift generator (2003), which costs less than numba's own."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    return state ^ (state << np.uint64(17))


@njit(
    "Tuple((u8, i8, f8))(f8[::1], i8[::1], f8[:,:,::1], f8[:,:,::1], i8[:,:,::1], i8[:,:,::1], f8, b1, i8, f8, f8, f8,"
    " u8, i8, f8, i8[::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def anneal(
    goal: Array,
    previous: Index,
    up: Array,
    down: Array,
    differing: Index,
    switched: Index,
    tolerance: float,
    first: bool,
    moves: int,
    hot: float,
    cold: float,
    error_of_a_switch: float,
    random: np.uint64,
    fewest: int,
    nearest: float,
    best: Index,
) -> tuple[np.uint64, int, float]:
    """Improves `best` by a run: fewest switches within the tolerance, otherwise least error.

    Returns:
        State of the random generator; switches of `best`, NONE if it is outside the tolerance; error of `best`.
    """
    count, actuators = len(best), switched.shape[2]
    own, temperature, fall = previous.copy(), hot, (cold / hot) ** (1 / moves)
    goals, tips = np.empty((count + 1, 2)), np.empty((count + 1, 2))
    goals[0] = goal
    for i in range(count):
        goals[i + 1, 0], goals[i + 1, 1] = moved(down[i, own[i]], goals[i, 0], goals[i, 1])
    tips_above(up, own, tips)
    error = np.sqrt((goals[0, 0] - tips[0, 0]) ** 2 + (goals[0, 1] - tips[0, 1]) ** 2)
    if error <= tolerance:
        return random, 0, error
    nearest, value, switches = min(error, nearest), (error - tolerance) / error_of_a_switch, 0
    for _ in range(moves):
        temperature *= fall
        random = drawn(random)
        choice = np.int64((random >> np.uint64(32)) * np.uint64(count * actuators) >> np.uint64(32))
        i, a = choice // actuators, choice % actuators
        j = switched[i, own[i], a]
        if j < 0:
            continue
        x, y = moved(down[i, j], goals[i, 0], goals[i, 1])
        error = np.sqrt((x - tips[i + 1, 0]) ** 2 + (y - tips[i + 1, 1]) ** 2)
        number = switches - differing[i, previous[i], own[i]] + differing[i, previous[i], j]
        new = number + max(error - tolerance, 0.0) / error_of_a_switch
        if new > value:
            random = drawn(random)
            if (random >> np.uint64(11)) * 2.0**-53 >= np.exp((value - new) / temperature):
                continue
        own[i], value, switches = j, new, number
        if error <= tolerance:
            if number < fewest:
                fewest, nearest = number, error
                best[:] = own
            if first:
                break
        elif error < nearest:
            nearest = error
            best[:] = own
        for k in range(i, count):
            goals[k + 1, 0], goals[k + 1, 1] = moved(down[k, own[k]], goals[k, 0], goals[k, 1])
        for k in range(i, -1, -1):
            tips[k, 0], tips[k, 1] = moved(up[k, own[k]], tips[k + 1, 0], tips[k + 1, 1])
    return random, fewest, nearest
