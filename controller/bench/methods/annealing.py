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
from numba import boolean, float64, int64, njit, uint64

from hyperbit.controller.bench.methods.planar import PLANAR, Array, Index, Planar, moved, planar, tips_above
from hyperbit.controller.bench.methods.two_list import NONE
from hyperbit.controller.manipulator.kernel_types import F1, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities


class Schedule(NamedTuple):
    """Schedule of a run: number of moves, first and last temperature [switches], error that weighs as one switch."""

    moves: int
    hot: float
    cold: float
    error_of_a_switch: float


class Switches(NamedTuple):
    """The arm, and the state after the switch of each actuator, shape (B, K, A); -1 if there is none."""

    arm: Planar
    switched: Index


class Aim(NamedTuple):
    """What is searched.

    Attributes:
        goal: position, shape (2,).
        previous: configuration from which switches are counted, shape (B,).
        tolerance: greatest error.
        first: whether a run ends with the first configuration within the tolerance.
    """

    goal: Array
    previous: Index
    tolerance: float
    first: bool


class Progress(NamedTuple):
    """Runs so far: state of the random generator; switches of the best, NONE outside the tolerance; its error."""

    random: np.uint64
    fewest: int
    nearest: float


SCHEDULE = named(Schedule, int64, float64, float64, float64)
SWITCHES = named(Switches, PLANAR, int64[:, :, ::1])
AIM = named(Aim, F1, I1, float64, boolean)
PROGRESS = named(Progress, uint64, int64, float64)

# The best schedules tried on the paper's arm. FEW, restarted, gave the fewest switches in 30 ms and in 300 ms. SOON was
# the first within the tolerance for 99 % of the goals.
FEW, SOON = Schedule(10_000, 2.0, 0.2, 0.03), Schedule(100_000, 4.0, 0.8, 0.01)
SEED = 0x9E3779B97F4A7C15  # the answer to a goal is reproducible


@dataclass(frozen=True, eq=False)
class AnnealingProblem:
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


def prepare(
    manipulator: Manipulator, densities: Densities | None, seconds: float, first: bool = False
) -> AnnealingProblem:
    """Returns the tables of an arm."""
    arm = planar(manipulator)
    bits = manipulator.bits.astype(int)
    switched = np.full(bits.shape, -1)
    for i, j in np.ndindex(bits.shape[:2]):
        for to in range(arm.states[i]):
            if j < arm.states[i] and arm.differing[i, j, to] == 1:
                switched[i, j, np.argmax(bits[i, j] != bits[i, to])] = to
    return AnnealingProblem(arm, switched, seconds, first)


def solve(problem: AnnealingProblem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    until, best = time.perf_counter() + problem.seconds, np.array(previous)
    switches, aim = Switches(problem.arm, problem.switched), Aim(goal, previous, tolerance, problem.first)
    schedule, progress = SOON if problem.first else FEW, Progress(np.uint64(SEED), NONE, np.inf)
    while True:
        progress = anneal(switches, aim, schedule, progress, best)
        if (problem.first and progress.nearest <= tolerance) or progress.fewest == 0 or time.perf_counter() >= until:
            return best


@njit("u8(u8)", cache=True, nogil=True, inline="always")
def drawn(state: np.uint64) -> np.uint64:
    """Returns the next state of Marsaglia's xorshift generator (2003), which costs less than numba's own."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    return state ^ (state << np.uint64(17))


@njit(
    [PROGRESS(SWITCHES, AIM, SCHEDULE, PROGRESS, I1)],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def anneal(table: Switches, aim: Aim, schedule: Schedule, progress: Progress, best: Index) -> Progress:
    """Improves `best` (B,) by a run: fewest switches within the tolerance, otherwise least error."""
    (_, up, down, differing), switched = table
    goal, previous, tolerance, first = aim
    moves, hot, cold, error_of_a_switch = schedule
    random, fewest, nearest = progress
    count, actuators = len(best), switched.shape[2]
    own, temperature, fall = previous.copy(), hot, (cold / hot) ** (1 / moves)
    goals, tips = np.empty((count + 1, 2)), np.empty((count + 1, 2))
    goals[0] = goal
    for i in range(count):
        goals[i + 1, 0], goals[i + 1, 1] = moved(down[i, own[i]], goals[i, 0], goals[i, 1])
    tips_above(up, own, tips)
    error = np.sqrt((goals[0, 0] - tips[0, 0]) ** 2 + (goals[0, 1] - tips[0, 1]) ** 2)
    if error <= tolerance:
        return Progress(random, 0, error)
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
    return Progress(random, fewest, nearest)
