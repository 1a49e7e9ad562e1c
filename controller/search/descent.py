"""Descents of the configuration tree, from base to tip: POP and IPOP (section 3.2), and a beam search."""

from typing import Any

import numpy as np
from numba import float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.kernel_types import F1, F2, I1, I2
from controller.obstacles.scene import Scene, for_scenes, module_collides, set_state
from controller.workspace.reachability import LEVELS, TABLES, Levels, Tables, measure

Array = NDArray[np.float64]
Index = NDArray[np.int64]

POINT: Any = types.UniTuple(float64, 3)  # type: ignore[no-untyped-call]


@njit(
    for_scenes(lambda scene: POINT(F1, TABLES, LEVELS, F2, F1, int64, I1, scene)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def descend(
    goal: Array,
    arm: Tables,
    levels: Levels,
    stage_costs: Array,
    thresholds: Array,
    depth: int,
    configuration: Index,
    scene: Scene | None,
) -> tuple[float, float, float]:
    """Decides modules 1 to `depth`; writes their states to `configuration`, returns the goal in frame F_depth.

    Of a module's states whose measure is at least the threshold of the level, the one with the least cost is taken.
    Ties are broken by the greater measure. If no state reaches the threshold, the one with the greatest measure is
    taken. POP has infinite thresholds. States in which the module collides are skipped. If no state remains, the
    descent ends and returns NaN.

    Args:
        goal: position in frame F_0, shape (3,).
        arm: configuration sets.
        levels: densities.
        stage_costs: the secondary criterion, shape (B, Kmax).
        thresholds: thresholds of the primary criterion, by level, shape (B+1,).
        depth: number of modules to decide.
        configuration: written, shape (B,).
        scene: obstacles, None if there are none.
    """
    rotations, translations, states = arm
    x, y, z = goal[0], goal[1], goal[2]
    for i in range(depth):
        best, best_measure, best_cost, best_passes = -1, 0.0, 0.0, False
        bx, by, bz = 0.0, 0.0, 0.0
        for j in range(states[i]):
            r, b = rotations[i, j], translations[i, j]
            dx, dy, dz = x - b[0], y - b[1], z - b[2]
            qx = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
            qy = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
            qz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
            m = measure(levels, i + 1, qx, qy, qz)
            passes = m >= thresholds[i + 1]
            if best < 0 or (passes and not best_passes):
                better = True
            elif passes != best_passes:
                better = False
            elif passes and stage_costs[i, j] != best_cost:
                better = stage_costs[i, j] < best_cost
            else:
                better = m > best_measure
            if scene is not None and better:
                scene.states[i] = j
                better = not module_collides(scene, i)
            if better:
                best, best_measure, best_cost, best_passes = j, m, stage_costs[i, j], passes
                bx, by, bz = qx, qy, qz
        if scene is not None:
            if best < 0:
                return np.nan, np.nan, np.nan
            set_state(scene, i, best)
        configuration[i] = best
        x, y, z = bx, by, bz
    return x, y, z


@njit(
    for_scenes(lambda scene: int64(F1, TABLES, LEVELS, F2, float64, int64, I2, F2, F1, scene)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def beam_search(
    goal: Array,
    arm: Tables,
    levels: Levels,
    costs: Array,
    worth: float,
    depth: int,
    configurations: Index,
    wanted: Array,
    prices: Array,
    scene: Scene | None,
) -> int:
    """Decides modules 1 to `depth` of up to W configurations at once: a beam search of the configuration tree.

    The score of a node is its cost less `worth` times its measure. Of all clear children of a level, the W with the
    least scores survive. Writes their states to `configurations` (W, B), the goal in frame F_depth to `wanted` (W, 3),
    and the costs so far to `prices` (W,), the best first. Returns the number of configurations that can reach the goal.

    Args:
        goal: position in frame F_0, shape (3,).
        arm: configuration sets.
        levels: densities.
        costs: cost of each module's states, shape (B, Kmax).
        worth: cost that one unit of the measure is worth.
        depth: number of modules to decide.
        configurations: written.
        wanted: written.
        prices: written.
        scene: obstacles, None if there are none.
    """
    rotations, translations, states = arm
    width, most = len(prices), len(prices) * states.max()
    parents, choices = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    scores, points, totals = np.empty(most), np.empty((most, 3)), np.empty(most)
    survivors = np.empty_like(configurations)
    wanted[0, 0], wanted[0, 1], wanted[0, 2] = goal[0], goal[1], goal[2]
    prices[0], count = 0.0, 1
    for i in range(depth):
        born = 0
        for n in range(count):
            x, y, z = wanted[n, 0], wanted[n, 1], wanted[n, 2]
            if scene is not None:
                for k in range(i):
                    set_state(scene, k, configurations[n, k])
            for j in range(states[i]):
                if scene is not None:
                    scene.states[i] = j
                    if module_collides(scene, i):
                        continue
                r, b = rotations[i, j], translations[i, j]
                dx, dy, dz = x - b[0], y - b[1], z - b[2]
                points[born, 0] = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
                points[born, 1] = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
                points[born, 2] = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
                p = points[born]
                m = measure(levels, i + 1, p[0], p[1], p[2])
                parents[born], choices[born], totals[born] = n, j, prices[n] + costs[i, j]
                # A node that cannot reach the goal is worse than any node that can.
                scores[born] = totals[born] - worth * m if m >= 0 else 1e12 - m
                born += 1
        order = np.argsort(scores[:born])
        count = min(born, width)
        if i == depth - 1:  # drop configurations that cannot reach the goal
            while count > 0 and scores[order[count - 1]] >= 1e12:
                count -= 1
        for n in range(count):
            k = order[n]
            for j in range(i):
                survivors[n, j] = configurations[parents[k], j]
            survivors[n, i] = choices[k]
            wanted[n, 0], wanted[n, 1], wanted[n, 2] = points[k, 0], points[k, 1], points[k, 2]
            prices[n] = totals[k]
        for n in range(count):
            for j in range(i + 1):
                configurations[n, j] = survivors[n, j]
    return count
