"""Two-by-two search, after Motahari, Zohoor and Korayem 2013.

"A new inverse kinematic algorithm for discretely actuated hyper-redundant manipulators".

From base to tip, two modules at a time are open. The search takes the pair of states that brings the tip nearest to the
goal, with the modules above at the mean of their workspace. Then it improves the tip: it repeatedly takes the best
states of the best pair of modules, until the tip is within the tolerance or no pair improves it.

The full text of the paper was not available. The two open modules in each step are from Motahari 2024, "Solving the
inverse kinematics problem of discretely actuated hyper-redundant manipulators using the multi-module searching method",
which generalizes the method. We chose that consecutive pairs overlap in one module, because more goals are then within
the tolerance, and we chose the order of improvement.
"""

from typing import NamedTuple

import numpy as np

from hyperbit.controller.bench.methods.planar import Array, Index, Planar, moved, planar, tips_above
from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities


class TwoByTwo(NamedTuple):
    """The arm, and the mean of each intermediate workspace in its own frame, shape (B+1, 2)."""

    arm: Planar
    means: Array


def prepare(manipulator: Manipulator, densities: Densities | None) -> TwoByTwo:
    arm = planar(manipulator)
    means = np.zeros((len(arm.states) + 1, 2))
    for i in reversed(range(len(arm.states))):
        c, s, x, y = arm.up[i, : arm.states[i]].mean(axis=0)  # motions are affine: mean of images = image of mean
        px, py = means[i + 1]
        means[i] = c * px - s * py + x, s * px + c * py + y
    return TwoByTwo(arm, means)


def solve(tables: TwoByTwo, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    arm, configuration = tables.arm, np.zeros(len(previous), dtype=np.int64)
    place(goal, arm.down, arm.states, tables.means, configuration)
    improve(goal, arm.up, arm.down, arm.states, tolerance, configuration)
    return configuration


@kernel("void(f8[::1], f8[:,:,::1], i8[::1], f8[:,::1], i8[::1])", error_model="numpy")
def place(goal: Array, down: Array, states: Index, means: Array, configuration: Index) -> None:
    """Writes a first configuration; of each pair the lower module is fixed, the upper one stays open."""
    x, y = goal[0], goal[1]
    for i in range(max(len(states) - 1, 1)):
        upper = min(i + 1, len(states) - 1)
        best = np.inf
        for j in range(states[i]):
            px, py = moved(down[i, j], x, y)
            for k in range(states[upper] if upper > i else 1):
                qx, qy = moved(down[upper, k], px, py) if upper > i else (px, py)
                square = (qx - means[upper + 1, 0]) ** 2 + (qy - means[upper + 1, 1]) ** 2
                if square < best:
                    best, configuration[i] = square, j
                    if upper > i:
                        configuration[upper] = k
        x, y = moved(down[i, configuration[i]], x, y)


@kernel("void(f8[::1], f8[:,:,::1], f8[:,:,::1], i8[::1], f8, i8[::1])", error_model="numpy")
def improve(goal: Array, up: Array, down: Array, states: Index, tolerance: float, configuration: Index) -> None:
    """Takes the best states of any two modules repeatedly, until within the tolerance or no pair improves the tip."""
    count = len(states)
    tips = np.empty((count + 1, 2))
    tips_above(up, configuration, tips)
    best = (goal[0] - tips[0, 0]) ** 2 + (goal[1] - tips[0, 1]) ** 2
    while best > tolerance * tolerance:
        first, second, to_first, to_second = -1, -1, 0, 0
        x, y = goal[0], goal[1]
        for i in range(count - 1):
            for j in range(states[i]):
                px, py = moved(down[i, j], x, y)
                for h in range(i + 1, count):
                    for k in range(states[h]):
                        qx, qy = moved(down[h, k], px, py)
                        square = (qx - tips[h + 1, 0]) ** 2 + (qy - tips[h + 1, 1]) ** 2
                        if square < best:
                            best, first, second, to_first, to_second = square, i, h, j, k
                    px, py = moved(down[h, configuration[h]], px, py)
            x, y = moved(down[i, configuration[i]], x, y)
        if first < 0:
            break
        configuration[first], configuration[second] = to_first, to_second
        tips_above(up, configuration, tips)
