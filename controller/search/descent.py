"""Descents of the configuration tree, from base to tip: POP and IPOP (section 3.2), and a beam search."""

from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, njit, types
from numpy.typing import NDArray

from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, I2, UNCOUNTED, named
from hyperbit.controller.obstacles.scene import Scene, for_scenes, module_collides, set_state
from hyperbit.controller.workspace.reachability import LEVELS, POINT, TABLES, Levels, ReachTables, measure, seen_from

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Point = tuple[float, float, float]

UNREACHABLE = 1e12  # score of a node that cannot reach the goal: worse than that of any node that can


class DescentTables(NamedTuple):
    """What a descent goes by."""

    arm: ReachTables  # configuration sets
    levels: Levels  # densities
    costs: Array  # cost of each module's states, shape (B, Kmax)
    depth: int  # number of modules to decide


class Beam(NamedTuple):
    """The nodes of one level of a beam search, the best first."""

    configurations: Index  # shape (W, B)
    wanted: Array  # position of the goal in the frame of each node, shape (W, 3)
    costs: Array  # cost of each node, shape (W,)


class Children(NamedTuple):
    """Scratch: the children of a beam's nodes."""

    parents: Index  # node of each child, shape (n,)
    choices: Index  # its state of the last module, shape (n,)
    scores: Array  # shape (n,)
    wanted: Array  # position of the goal in its frame, shape (n, 3)
    costs: Array  # shape (n,)


DESCENT_TABLES = named(DescentTables, TABLES, LEVELS, F2, int64)
BEAM = named(Beam, I2, F2, F1)
CHILDREN = named(Children, I1, I1, F1, F2, F1)
CHOICE: Any = types.Tuple((int64, POINT))  # type: ignore[no-untyped-call]


@njit(
    for_scenes(lambda scene: CHOICE(DESCENT_TABLES, int64, POINT, float64, scene)),
    **UNCOUNTED,
    error_model="numpy",
)
def best_state(tables: DescentTables, i: int, goal: Point, threshold: float, scene: Scene | None) -> tuple[int, Point]:
    """Returns the best clear state of module i, -1 if all collide, and the goal in the frame above it.

    Among states whose measure is at least the threshold, the one with the least cost is the best. Ties are broken by
    the greater measure. If no state reaches the threshold, the one with the greatest measure is the best.
    """
    rotations, translations, states = tables.arm
    best, best_measure, best_cost, best_passes, best_goal = -1, 0.0, 0.0, False, goal
    for j in range(states[i]):
        seen = seen_from(rotations[i, j], translations[i, j], goal[0], goal[1], goal[2])
        m, cost = measure(tables.levels, i + 1, seen[0], seen[1], seen[2]), tables.costs[i, j]
        passes = m >= threshold
        if best < 0:
            better = True
        elif passes != best_passes:
            better = passes
        elif passes and cost != best_cost:
            better = cost < best_cost
        else:
            better = m > best_measure
        if scene is not None and better:
            scene.states[i] = j
            better = not module_collides(scene, i)
        if better:
            best, best_measure, best_cost, best_passes, best_goal = j, m, cost, passes, seen
    return best, best_goal


@njit(
    for_scenes(lambda scene: POINT(POINT, DESCENT_TABLES, F1, I1, scene)),
    **UNCOUNTED,
    error_model="numpy",
)
def descend(goal: Point, tables: DescentTables, thresholds: Array, configuration: Index, scene: Scene | None) -> Point:
    """Decides modules 1 to `depth`; writes their states to `configuration`, returns the goal in frame F_depth.

    Each module takes its best state, see best_state. POP has infinite thresholds. If all states of a module collide,
    the descent ends and returns NaN.

    Args:
        goal: position in frame F_0.
        tables: configuration sets, densities, and the secondary criterion as costs.
        thresholds: thresholds of the primary criterion, by level, shape (B+1,).
        configuration: written, shape (B,).
        scene: obstacles, None if there are none.
    """
    for i in range(tables.depth):
        best, goal = best_state(tables, i, goal, thresholds[i + 1], scene)
        if scene is not None:
            if best < 0:
                return np.nan, np.nan, np.nan
            set_state(scene, i, best)
        configuration[i] = best
    return goal


@njit(
    for_scenes(lambda scene: int64(DESCENT_TABLES, int64, float64, BEAM, int64, CHILDREN, scene)),
    **UNCOUNTED,
    error_model="numpy",
)
def expand(
    tables: DescentTables, i: int, worth: float, beam: Beam, count: int, children: Children, scene: Scene | None
) -> int:
    """Writes the clear children of the first `count` nodes, which decide module i; returns their number."""
    rotations, translations, states = tables.arm
    configurations, wanted, costs = beam
    born = 0
    for n in range(count):
        if scene is not None:
            for k in range(i):
                set_state(scene, k, configurations[n, k])
        for j in range(states[i]):
            if scene is not None:
                scene.states[i] = j
                if module_collides(scene, i):
                    continue
            x, y, z = seen_from(rotations[i, j], translations[i, j], wanted[n, 0], wanted[n, 1], wanted[n, 2])
            m, cost = measure(tables.levels, i + 1, x, y, z), costs[n] + tables.costs[i, j]
            children.parents[born], children.choices[born], children.costs[born] = n, j, cost
            children.wanted[born, 0], children.wanted[born, 1], children.wanted[born, 2] = x, y, z
            children.scores[born] = cost - worth * m if m >= 0 else UNREACHABLE - m
            born += 1
    return born


@njit(types.void(CHILDREN, I1, int64, BEAM, I2), cache=True, nogil=True)
def replace_nodes(children: Children, chosen: Index, i: int, beam: Beam, before: Index) -> None:
    """Replaces the nodes of a beam by chosen children (n,), which decide module i; `before` (W, B) is scratch."""
    configurations, wanted, costs = beam
    for n in range(len(costs)):
        for j in range(i):
            before[n, j] = configurations[n, j]
    for n in range(len(chosen)):
        child = chosen[n]
        for j in range(i):
            configurations[n, j] = before[children.parents[child], j]
        configurations[n, i], costs[n] = children.choices[child], children.costs[child]
        for a in range(3):
            wanted[n, a] = children.wanted[child, a]


@njit(
    for_scenes(lambda scene: int64(F1, DESCENT_TABLES, float64, BEAM, scene)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def beam_search(goal: Array, tables: DescentTables, worth: float, beam: Beam, scene: Scene | None) -> int:
    """Decides modules 1 to `depth` of up to W configurations at once: a beam search of the configuration tree.

    The score of a node is its cost less `worth` times its measure. Of all clear children of a level, the W with the
    least scores survive. Returns the number of configurations that can reach the goal.

    Args:
        goal: position in frame F_0, shape (3,).
        tables: configuration sets, densities and costs.
        worth: cost that one unit of the measure is worth.
        beam: written, with the goal in frame F_depth.
        scene: obstacles, None if there are none.
    """
    width, before = len(beam.costs), np.zeros_like(beam.configurations)
    most = width * tables.arm.states.max()
    whole, parts = np.empty((2, most), dtype=np.int64), np.empty((2, most))
    children = Children(whole[0], whole[1], parts[0], np.empty((most, 3)), parts[1])
    beam.wanted[0, 0], beam.wanted[0, 1], beam.wanted[0, 2] = goal[0], goal[1], goal[2]
    beam.costs[0], count = 0.0, 1
    for i in range(tables.depth):
        born = expand(tables, i, worth, beam, count, children, scene)
        order = np.argsort(children.scores[:born])
        count = min(born, width)
        if i == tables.depth - 1:  # drop configurations that cannot reach the goal
            while count > 0 and children.scores[order[count - 1]] >= UNREACHABLE:
                count -= 1
        replace_nodes(children, order[:count], i, beam, before)
    return count
