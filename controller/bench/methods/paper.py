"""POP and IPOP as printed: Ebert-Uphoff and Chirikjian 1996, sections 3.2.1 and 3.2.2. Only pixels decide.

POP takes the branch of greatest density at each module. The paper does not specify the case that no branch has a
density. Then this implementation takes the branch with the nearest pixel that has one, which favours the method over an
arbitrary branch.

IPOP, similarity to the previous configuration: among the branches whose density exceeds a threshold, one for the whole
arm, the descent takes the unchanged state of a module, regardless of its actuators. Among changed states it takes the
densest; the paper does not specify this. The paper's weights by module have no effect, because modules are decided one
at a time.
"""

from dataclasses import dataclass

import numpy as np
from numba import types
from numpy.typing import NDArray

from hyperbit.controller.bench.methods.planar import PLANAR, Array, Index, Planar, moved, planar
from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, I1, I2
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.reachability import LEVELS, Levels, levels_of

# Points per unit of area; the paper gives no value. Among 1e5 to 1e9, this value gave the least error and the greatest
# share within the tolerance on the paper's arm. A tenth of it saves nearly one switch, but misses more goals.
THRESHOLD = 1e8


@dataclass(frozen=True, eq=False)
class PaperTables:
    arm: Planar
    densities: Densities


def prepare(manipulator: Manipulator, densities: Densities) -> PaperTables:
    return PaperTables(planar(manipulator), densities)


def solve_pop(tables: PaperTables, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,). No density passes the threshold, so costs do not matter."""
    return descent(tables, goal, tables.arm.costs(previous), np.full(len(previous) + 1, np.inf))


def solve_ipop(tables: PaperTables, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    states = np.arange(tables.arm.differing.shape[2])
    changed = np.asarray(states != np.asarray(previous)[:, None], dtype=np.int64)
    thresholds = np.asarray(np.log(np.maximum(THRESHOLD * tables.densities.pixels**2, 1.0)))
    return descent(tables, goal, changed, thresholds)


def descent(tables: PaperTables, goal: Array, stage_costs: Index, thresholds: Array) -> Configuration:
    """Returns the descent's configuration (B,); `thresholds` (B+1,) are compared with ln(count) of a pixel."""
    configuration = np.zeros(len(tables.arm.states), dtype=np.int64)
    descend(goal, tables.arm, levels_of(tables.densities), stage_costs, thresholds, configuration)
    return configuration


@kernel("f8(f4[::1], i8, i8[::1], f8[::1], f8, f8, f8)", error_model="numpy", inline="always")
def density(
    values: NDArray[np.float32], offset: int, shape: Index, reference: Array, pixel: float, x: float, y: float
) -> float:
    """Returns ln of the count in the point's pixel; outside the grid, minus the distance to the nearest pixel."""
    fx, fy = (x - reference[0]) / pixel, (y - reference[1]) / pixel
    ix = min(max(int(np.floor(fx + 0.5)), 0), shape[2] - 1)
    iy = min(max(int(np.floor(fy + 0.5)), 0), shape[1] - 1)
    value = float(values[offset + iy * shape[2] + ix])
    if max(abs(fx - ix), abs(fy - iy)) > 0.51:
        value = min(value, 0.0) - pixel * np.sqrt((fx - ix) ** 2 + (fy - iy) ** 2)
    return value


@kernel(types.void(F1, PLANAR, LEVELS, I2, F1, I1), error_model="numpy")
def descend(
    goal: Array, arm: Planar, levels: Levels, stage_costs: Index, thresholds: Array, configuration: Index
) -> None:
    """Writes the configuration: the branch of least stage cost above the threshold, otherwise the densest."""
    states, _, down, _ = arm
    values, offsets, shapes, references, pixels = levels
    x, y = goal[0], goal[1]
    for i in range(len(states)):
        best, best_density, best_cost, best_passes = -1, 0.0, 0, False
        for j in range(states[i]):
            px, py = moved(down[i, j], x, y)
            n = i + 1
            value = density(values, offsets[n], shapes[n], references[n], pixels[n], px, py)
            passes = value >= thresholds[n]
            if passes == best_passes:
                better = (
                    stage_costs[i, j] < best_cost if passes and stage_costs[i, j] != best_cost else value > best_density
                )
            else:
                better = passes
            if best < 0 or better:
                best, best_density, best_cost, best_passes = j, value, stage_costs[i, j], passes
        configuration[i] = best
        x, y = moved(down[i, best], x, y)
