"""Branch and bound: a depth-first search of the configuration tree, pruned by cost-to-go maps. For planar arms.

A node decides the modules up to a level. Its lower bound is its cost plus the cost to go of the goal in its frame. The
search is iterative deepening (Korf 1985, "Depth-first iterative-deepening: an optimal admissible tree search"): nodes
with a lower bound above a threshold are passed over. A complete search of the tree proves the threshold; the next one
is the least lower bound passed over. Poses have two costs to go, of position and heading; the greater counts.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.clock import MAPS as MAPS_PRICE
from hyperbit.controller.search.clock import NODE, WALL, Clock
from hyperbit.controller.search.lists.segment import motions
from hyperbit.controller.search.solution import EPSILON, Incumbent
from hyperbit.controller.search.target import QUERY, SearchQuery, SearchTarget, reaches, search_radius
from hyperbit.controller.workspace.cost_to_go import MAPS, UNREACHABLE, CostToGo, Maps, in_levels
from hyperbit.controller.workspace.heading_to_go import BINS, HEADINGS, PART_BITS, Headings, HeadingToGo, parts
from hyperbit.controller.workspace.hull import Hull

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

AT_ONCE = 1 << 14  # nodes between two checks of the deadline
RISE = 4  # least rise of a threshold in levels of the maps: half the least cost of a switch


class Tree(NamedTuple):
    """The configuration tree of a planar arm."""

    motions: Array  # frames of all states as rows, see segment, shape (B * Kmax, 4)
    states: Integers  # K_i, shape (B,)
    ranked: Integers  # states of each module, cheapest first, shape (B * Kmax,)
    costs: Array  # cost of each module's states, shape (B, Kmax)
    per: Array  # pixels of the maps per unit of length, by level, shape (B + 1,)


class Walk(NamedTuple):
    """The state of an interrupted search."""

    points: Array  # position of the goal in the frame of each level's node, shape (B + 1, 2)
    headings: Integers  # heading of the goal in this frame, in parts of the circle, shape (B + 1,)
    prices: Array  # cost of each level's node, shape (B + 1,)
    tried: Integers  # number of children of each level's node that were tried, shape (B + 1,)
    configuration: Integers  # configuration of the current path, or the one found, shape (B,)
    level: Integers  # level of the current node, shape (1,); -1 after a complete search
    bounds: Array  # threshold, least lower bound passed over, cost of the incumbent, shape (3,)
    nodes: Integers  # number of nodes that the last call searched, shape (1,)


PLACE: Any = types.UniTuple(float64, 2)  # type: ignore[no-untyped-call]
TREE = named(Tree, F2, I1, I1, F2, F1)
WALK = named(Walk, F2, I1, F1, I1, I1, I1, F1, I1)


class BranchAndBound:
    """Branch and bound for one planar arm, with its maps."""

    def __init__(self, manipulator: Manipulator, hull: Hull) -> None:
        self._m, self._motions = manipulator, motions(manipulator)
        self.maps, self._to_turn = CostToGo(manipulator, hull.boxes), HeadingToGo(manipulator)
        self._walk: Walk | None = None
        self._map_time = 0.0

    @property
    def begun(self) -> bool:
        """Whether a search of the current goal has started."""
        return self._walk is not None

    def claim(self) -> None:
        """Touches the memory, so that no search waits for page faults, and measures the time for maps."""
        costs = np.ones(self._m.bits.shape[:2])
        self.maps.maps(costs, search_radius(self._m, 1e-3 * self._m.length))
        began = WALL.now()
        self.maps.maps(2.0 * costs, search_radius(self._m, 1e-3 * self._m.length))
        self._map_time = WALL.now() - began

    def map_time(self, target: SearchTarget, costs: Array, clock: Clock) -> float:
        """Returns the approximate time for the maps of a goal [s]; 0 if they are ready."""
        measured = 0.0 if self.maps.ready(costs, target.radius) else self._map_time
        return clock.expected(measured, 0.0 if self.begun else MAPS_PRICE)

    def begin(self) -> None:
        """Starts a new goal."""
        self._walk = None

    def run(self, target: SearchTarget, seed: Configuration, costs: Array, incumbent: Incumbent, until: float) -> None:
        """Searches until the incumbent is proven, or until a time by its clock.

        A second call for the same goal continues the search.
        """
        m, maps = self._m, self.maps.maps(costs, target.radius)
        padded = np.where(np.arange(costs.shape[1]) < m.states[:, None], costs, np.inf)
        ranked = np.argsort(padded, axis=1, kind="stable").ravel()
        tree = Tree(self._motions, m.states, ranked, costs, 1.0 / maps.pixels)
        angle = 2 * math.asin(math.sqrt(target.chord) / 2) if target.oriented and target.chord < 4 else math.inf
        headings = self._to_turn.headings(in_levels(costs)[1], UNREACHABLE, angle)
        clock = incumbent.clock
        if self._walk is None:
            self._walk = start(target, seed, incumbent.bound)
            clock.charge(MAPS_PRICE)
        walk = self._walk
        while not incumbent.over and clock.now() < until:
            walk.bounds[2] = incumbent.cost
            found = search(tree, maps, headings, target.query, target.scene, walk, AT_ONCE)
            clock.charge(NODE * int(walk.nodes[0]))
            if found:
                configuration = walk.configuration.copy()
                incumbent.offer(configuration, float(walk.prices[-1]), target.square(m.tip(configuration)))
            elif walk.level[0] < 0:
                incumbent.prove(min(walk.bounds[1], incumbent.cost))
                # Different weights give many lower bounds, so each threshold rises by at least part of a switch.
                walk.bounds[:2] = max(incumbent.bound, walk.bounds[0] + RISE * maps.unit), np.inf
                walk.level[0] = walk.tried[0] = 0


def start(target: SearchTarget, seed: Configuration, bound: float) -> Walk:
    """Returns the start of a search: goal, seed (B,) and first threshold."""
    levels = len(seed) + 1
    points, headings = np.zeros((levels, 2)), np.zeros(levels, dtype=np.int64)
    points[0] = target.position[:2]
    headings[0] = parts(target.rotation[1, 0], target.rotation[0, 0])
    tried, level, nodes = (np.zeros(size, dtype=np.int64) for size in (levels, 1, 1))
    bounds = np.array((bound, np.inf, np.inf))
    return Walk(points, headings, np.zeros(levels), tried, seed.copy(), level, bounds, nodes)


@kernel([PLACE(F2, int64, float64, float64)], **UNCOUNTED, inline="always")
def seen_above(motions: Array, row: int, x: float, y: float) -> tuple[float, float]:
    """Returns a point (x, y) as seen from the frame above a module in a state, a row of `motions`."""
    c, s = motions[row, 2], motions[row, 3]
    dx, dy = x - motions[row, 0], y - motions[row, 1]
    return c * dx + s * dy, c * dy - s * dx


@kernel(int64(MAPS, int64, float64, float64, float64), **UNCOUNTED, inline="always")
def cost_to_go(maps: Maps, level: int, x: float, y: float, per: float) -> int:
    """Returns the cost to go of a point (x, y) in a map of `per` pixels per unit of length; see Maps."""
    u, v = (x - maps.corners[level, 0]) * per, (y - maps.corners[level, 1]) * per
    nx, ny = maps.shapes[level, 0], maps.shapes[level, 1]
    if not (0.0 <= u < nx and 0.0 <= v < ny):
        return UNREACHABLE
    return int(maps.values[maps.offsets[level] + int(u) * ny + int(v)])


@kernel(
    for_scenes(lambda scene: boolean(TREE, MAPS, HEADINGS, QUERY, scene, WALK, int64)),
    **UNCOUNTED,
    error_model="numpy",
)
def search(
    tree: Tree, maps: Maps, to_turn: Headings, query: SearchQuery, scene: Scene | None, walk: Walk, nodes: int
) -> bool:
    """Searches a number of nodes; returns whether it found a configuration better than the incumbent.

    `walk` then has the configuration, and its cost at the last level. The next call continues from there.
    """
    motions, states, ranked, costs, per = tree
    points, headings, prices, tried, configuration, at, bounds, _ = walk
    turns, oriented = to_turn.turns, len(to_turn.values) > 0
    count, most, level, above = len(states), costs.shape[1], at[0], bounds[1]
    threshold, ceiling, most_nodes = bounds[0] * (1 + EPSILON), bounds[2] * (1 - EPSILON), nodes
    while level >= 0:
        turn = tried[level]
        if turn == states[level]:
            level -= 1
            continue
        j = ranked[level * most + turn]
        price = prices[level] + costs[level, j]
        if price > threshold or price >= ceiling:  # the following states cost more
            if price < ceiling:
                above = min(above, price)
            level -= 1
            continue
        tried[level] = turn + 1
        row, child, heading = level * most + j, level + 1, 0
        if oriented:
            heading = headings[level] - turns[row]
            value = to_turn.values[child, (heading >> PART_BITS) & (BINS - 1)]
            if price + maps.unit * value > threshold:
                if value < UNREACHABLE:
                    above = min(above, price + maps.unit * value)
                continue
        x, y = seen_above(motions, row, points[level, 0], points[level, 1])
        if child >= maps.first:
            value = cost_to_go(maps, child, x, y, per[child])
            if value >= UNREACHABLE:
                continue
            least = price + maps.unit * value
            if least >= ceiling:
                continue
            if least > threshold:
                above = min(above, least)
                continue
        nodes -= 1
        prices[child] = price
        if child < count:
            points[child, 0], points[child, 1], headings[child], tried[child] = x, y, heading, 0
            level = child
        else:
            for i in range(count):
                configuration[i] = ranked[i * most + tried[i] - 1]
            if reaches(query, configuration) and (scene is None or not collides(scene, configuration)):
                at[0], bounds[1], walk.nodes[0] = level, above, most_nodes - nodes
                return True
        if nodes <= 0:
            break
    at[0], bounds[1], walk.nodes[0] = level, above, most_nodes - nodes
    return False
