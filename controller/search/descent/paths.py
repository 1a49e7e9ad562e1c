"""POP, IPOP (section 3.2) and a beam search: a descent by the densities, completed with the exact distal table."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, I2, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene, for_scenes, module_collides, set_state
from hyperbit.controller.search.clock import CHECKED, DESCENT, FINISHED, GROWN, WALL, Clock
from hyperbit.controller.search.descent.distal_table import DistalSearch, Wanted, build_distal_table, finish
from hyperbit.controller.search.method import PaperMethod, StageCosts, Variant, mean_cost, stage_costs
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.reachability import (
    LEVELS,
    POINT,
    TABLES,
    Levels,
    ReachTables,
    levels_of,
    measure,
    seen_from,
    tables_of,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Point = tuple[float, float, float]

# Thresholds of the primary criterion: expected number of configurations that end within the tolerance. A low threshold
# leaves more choice to the secondary criterion. The next is tried if the tolerance was not reached. Infinity is POP.
ENOUGH: tuple[float, ...] = (30.0, 1_000.0, 10_000.0, np.inf)

BEAM_WIDTH, BEAM_TIME = 64, 0.05  # width and time [s] of the beam search if obstacles end the descents
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


@kernel(
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


@kernel(
    for_scenes(lambda scene: POINT(POINT, DESCENT_TABLES, F1, I1, scene)),
    **UNCOUNTED,
    error_model="numpy",
)
def descend(goal: Point, tables: DescentTables, thresholds: Array, configuration: Index, scene: Scene | None) -> Point:
    """Decides modules 1 to `depth`; writes their states to `configuration` (B,), returns the goal in frame F_depth.

    Each module takes its best state, see best_state. If all states of a module collide, the descent ends and returns
    NaN. `goal` is in frame F_0. `thresholds` (B+1,) of the primary criterion are those of the levels; POP has infinite
    thresholds. The costs of the tables are the secondary criterion.
    """
    for i in range(tables.depth):
        best, goal = best_state(tables, i, goal, thresholds[i + 1], scene)
        if scene is not None:
            if best < 0:
                return np.nan, np.nan, np.nan
            set_state(scene, i, best)
        configuration[i] = best
    return goal


@kernel(
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


@kernel(types.void(CHILDREN, I1, int64, BEAM, I2))
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


@kernel(
    for_scenes(lambda scene: int64(F1, DESCENT_TABLES, float64, BEAM, scene)),
    error_model="numpy",
)
def beam_search(goal: Array, tables: DescentTables, worth: float, beam: Beam, scene: Scene | None) -> int:
    """Decides modules 1 to `depth` of up to W configurations at once: a beam search of the configuration tree.

    The score of a node is its cost less `worth` times its measure. Of all clear children of a level, the W with the
    least scores survive. Returns the number of configurations that can reach the goal (3,), given in frame F_0.
    `worth` is the cost of one unit of the measure. The beam is written, with the goal in frame F_depth.
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


class Paths:
    """POP, IPOP and a beam search of one manipulator; holds the distal table."""

    def __init__(self, manipulator: Manipulator, densities: Densities) -> None:
        self.manipulator = manipulator
        self.densities = densities
        self.table = build_distal_table(manipulator)
        self._arm, self._levels = tables_of(manipulator), levels_of(densities)
        self._edge = densities.edge()

    def follow(
        self, target: SearchTarget, previous: Configuration, method: PaperMethod | Variant, clock: Clock = WALL
    ) -> Configuration:
        """Returns the first configuration within the tolerances as the threshold rises, otherwise the nearest found.

        With obstacles the descents and a beam search first accept only configurations within the tolerances, then the
        nearest. The result is `previous` (B,) if all paths are blocked; the secondary criteria stay close to it.
        """
        best, aim, ladder = previous, target, ENOUGH
        most = least = np.inf if target.scene is None else within_squares(target)
        costs = stage_costs(method, self.manipulator, previous)
        if method == "pop":
            aim, ladder = replace(target, tolerance=0.0), (np.inf,)  # the nearest
        for enough in ladder:
            configuration, square, within = self._descend(aim, costs, enough, most, clock)
            if square < least or within:
                best, least = configuration, square
            if within:
                break
        if least == most and target.scene is not None:
            best, least = self._around(aim, costs, best, most, clock)
        if least == most and target.scene is not None:
            configuration, square, _ = self._descend(aim, costs, np.inf, np.inf, clock)
            best = configuration if square < np.inf else self._around(aim, costs, best, np.inf, clock)[0]
        return best

    def widen(self, target: SearchTarget, costs: StageCosts, width: int, incumbent: Incumbent) -> None:
        """Offers the configurations of a beam search to the incumbent; `costs` (B, Kmax) are those of the states."""
        modules = np.arange(len(self.manipulator.modules))
        most, worth, clock = within_squares(target), mean_cost(self.manipulator, costs), incumbent.clock
        for configuration, wanted, price in self._beam(target.position, target.scene, costs, worth, width, clock):
            if price < incumbent.cost:
                square, within = self.finish(wanted, target, costs, configuration, most, clock)
                cost = float(costs[modules, configuration].sum())
                if within and cost < incumbent.cost and target.met(configuration):
                    incumbent.offer(configuration, cost, square)

    def finish(
        self,
        wanted: Array,
        target: SearchTarget,
        costs: StageCosts,
        configuration: Configuration,
        most: float = np.inf,
        clock: Clock = WALL,
    ) -> tuple[float, bool]:
        """Decides the last modules for a position (3,) in frame F_root, see distal_table.finish; charges the clock."""
        asked = Wanted(target.rotation, target.tolerance, target.exact_chord, target.weight)
        search = DistalSearch(self.table, costs, self._arm)
        before = 0 if target.scene is None else int(target.scene.checks[1])
        found: tuple[float, bool] = finish(wanted, asked, most, search, configuration, target.scene)
        checks = 0 if target.scene is None else int(target.scene.checks[1]) - before
        clock.charge(FINISHED + CHECKED * checks)
        return found

    def _around(
        self, target: SearchTarget, costs: StageCosts, best: Configuration, most: float, clock: Clock
    ) -> tuple[Configuration, float]:
        """Returns the first configuration of a beam with a squared error below `most`, and this error.

        If there is none, `best` and `most` are returned.
        """
        towards, until = self._towards(target.position), clock.now() + BEAM_TIME
        for configuration, wanted, _ in self._beam(towards, target.scene, costs, 1.0, BEAM_WIDTH, clock):
            square, _ = self.finish(wanted, target, costs, configuration, most, clock)
            if square < most:
                return configuration, square
            if clock.now() > until:
                break
        return best, most

    def _beam(
        self, goal: Array, scene: Scene | None, costs: StageCosts, worth: float, width: int, clock: Clock
    ) -> Iterator[tuple[Configuration, Array, float]]:
        """Yields the configurations of a beam search below the table, the goal in frame F_root, and the costs so far.

        `goal` (3,) is in frame F_0, `worth` the cost that one unit of the measure is worth.
        """
        clock.charge(GROWN * width * int(self.manipulator.states[: self.table.root].sum()))
        configurations = np.zeros((width, len(self.manipulator.modules)), dtype=np.int64)
        beam = Beam(configurations, np.zeros((width, 3)), np.zeros(width))
        count = beam_search(goal, DescentTables(self._arm, self._levels, costs, self.table.root), worth, beam, scene)
        yield from zip(configurations[:count], beam.wanted, beam.costs.tolist(), strict=False)

    def _towards(self, goal: Array) -> Array:
        """Returns `goal`, or for a goal outside the box of W_0 the centre (3,) of the nearest pixel with points.

        Outside the box all densities are 0, and distances to the boxes would mislead the descent.
        """
        low, high = self.densities.box(0)
        if np.all((low <= goal) & (goal <= high)):
            return goal
        return np.asarray(self._edge[np.argmin(((self._edge - goal) ** 2).sum(axis=1))])

    def _descend(
        self, target: SearchTarget, costs: StageCosts, enough: float, most: float, clock: Clock
    ) -> tuple[Configuration, float, bool]:
        """Returns the configuration of one descent, its squared error, and whether it is within the tolerances.

        If the squared error is not below `most`, `most` is returned, and the configuration is not valid.
        """
        configuration = np.zeros(len(self.manipulator.modules), dtype=np.int64)
        x, y, z = self._towards(target.position).tolist()
        thresholds = self._thresholds(target, enough)
        clock.charge(DESCENT)
        tables = DescentTables(self._arm, self._levels, costs, self.table.root)
        wanted = descend((x, y, z), tables, thresholds, configuration, target.scene)
        if math.isnan(wanted[0]):
            return configuration, most, False
        square, within = self.finish(np.array(wanted), target, costs, configuration, most, clock)
        return configuration, square, within

    def _thresholds(self, target: SearchTarget, enough: float) -> NDArray[np.float64]:
        """Returns for each level the ln of a pixel's count at which `enough` points are expected within the tolerances.

        The distribution of orientations is assumed uniform.
        """
        if np.isinf(enough):
            return np.full(len(self.densities.pixels), np.inf)
        tolerance = target.tolerance
        ball = math.pi * tolerance**2 if self.manipulator.planar else 4 / 3 * math.pi * tolerance**3
        ball = max(ball * target.share, 1e-300)
        volumes = self.densities.pixels**self.manipulator.dimension
        return np.log(np.maximum(enough * volumes / ball, 1.0))


def within_squares(target: SearchTarget) -> float:
    """Returns an upper bound of the squared error, see SearchTarget, of all configurations within the tolerances."""
    return target.tolerance**2 * 1.001 + (target.weight**2 * target.chord if target.oriented else 0.0)
