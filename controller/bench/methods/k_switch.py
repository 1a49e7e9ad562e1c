"""k-switch search: Lees and Chirikjian 1996, "A combinatorial approach to trajectory planning for binary manipulators".

The search moves repeatedly to the best configuration that differs from the present one in at most k actuators, until it
is within the tolerance or cannot be improved. Within the tolerance fewer switches are better, outside it a smaller
error. The full text of the paper was not available; we chose this order to favour few switches.

The search enumerates only the changed modules. The tip is fixed in the frame above the last changed module, so each
configuration costs one motion of a point.
"""

from typing import NamedTuple

import numpy as np
from numba import float64, int64, types

from hyperbit.controller.bench.methods.planar import PLANAR, Array, Index, Planar, moved, planar, tips_above
from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, I1
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities


class KSwitch(NamedTuple):
    arm: Planar
    switches: int


def prepare(manipulator: Manipulator, densities: Densities | None, switches: int = 4) -> KSwitch:
    return KSwitch(planar(manipulator), switches)


def solve(tables: KSwitch, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    configuration = np.array(previous)
    search(goal, tables.arm, tables.switches, tolerance, configuration)
    return configuration


@kernel(types.void(F1, PLANAR, int64, float64, I1), error_model="numpy")
def search(goal: Array, arm: Planar, k: int, tolerance: float, configuration: Index) -> None:
    """Improves the configuration, by at most k switches at a time."""
    states, up, down, differing = arm
    count = len(states)
    tips = np.empty((count + 1, 2))
    # For each changed module: its index, its new state, the switches remaining for modules above it, and the goal in
    # the frame below the module that is tried next.
    module, state = np.zeros(k + 1, dtype=np.int64), np.zeros(k + 1, dtype=np.int64)
    remaining, xs, ys = np.zeros(k + 1, dtype=np.int64), np.zeros(k + 1), np.zeros(k + 1)
    changed, changed_to = np.zeros(k, dtype=np.int64), np.zeros(k, dtype=np.int64)
    limit = tolerance * tolerance
    tips_above(up, configuration, tips)
    best = (goal[0] - tips[0, 0]) ** 2 + (goal[1] - tips[0, 1]) ** 2
    while best > limit:
        changes, most_remaining = 0, -1
        module[0], state[0], remaining[0], xs[0], ys[0], depth = 0, -1, k, goal[0], goal[1], 0
        while depth >= 0:
            i = module[depth]
            state[depth] += 1
            j = state[depth]
            if j == states[i]:
                if i == count - 1:
                    depth -= 1
                else:
                    xs[depth], ys[depth] = moved(down[i, configuration[i]], xs[depth], ys[depth])
                    module[depth], state[depth] = i + 1, -1
                continue
            rest = remaining[depth] - differing[i, configuration[i], j]
            if rest < 0 or rest < most_remaining or j == configuration[i]:
                continue
            x, y = moved(down[i, j], xs[depth], ys[depth])
            square = (x - tips[i + 1, 0]) ** 2 + (y - tips[i + 1, 1]) ** 2
            if (square <= limit and (rest > most_remaining or square < best)) or (most_remaining < 0 and square < best):
                best, changes = square, depth + 1
                most_remaining = rest if square <= limit else -1
                for d in range(changes):
                    changed[d], changed_to[d] = module[d], state[d]
            if rest > 0 and i + 1 < count:
                depth += 1
                module[depth], state[depth], remaining[depth], xs[depth], ys[depth] = i + 1, -1, rest, x, y
        if changes == 0:
            break
        for d in range(changes):
            configuration[changed[d]] = changed_to[d]
        tips_above(up, configuration, tips)
