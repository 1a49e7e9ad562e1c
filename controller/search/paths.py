"""POP, IPOP (section 3.2) and a beam search: a descent by the densities, completed with the exact distal table."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene
from hyperbit.controller.search.clock import CHECKED, DESCENT, FINISHED, GROWN, WALL, Clock
from hyperbit.controller.search.descent import Beam, DescentTables, beam_search, descend
from hyperbit.controller.search.distal_table import DistalSearch, Wanted, build_distal_table, finish
from hyperbit.controller.search.method import PaperMethod, StageCosts, Variant, mean_cost, stage_costs
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.reachability import levels_of, tables_of

Vector = NDArray[np.float64]

# Thresholds of the primary criterion: expected number of configurations that end within the tolerance. A low threshold
# leaves more choice to the secondary criterion. The next is tried if the tolerance was not reached. Infinity is POP.
ENOUGH: tuple[float, ...] = (30.0, 1_000.0, 10_000.0, np.inf)

BEAM, BEAM_TIME = 64, 0.05  # width and time [s] of the beam search if obstacles end the descents


class Paths:
    """POP, IPOP and a beam search of one manipulator; holds the distal table."""

    def __init__(self, manipulator: Manipulator, densities: Densities) -> None:
        """Builds the distal table."""
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
        nearest. The result is `previous` if all paths are blocked.

        Args:
            target: the goal.
            previous: configuration to stay close to, shape (B,).
            method: the algorithm, and for IPOP the secondary criterion.
            clock: of the search.
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
        """Offers the configurations of a beam search to the incumbent.

        Args:
            target: the goal.
            costs: cost of each module's states, shape (B, Kmax).
            width: width of the beam.
            incumbent: the best so far.
        """
        modules = np.arange(len(self.manipulator.modules))
        most, worth, clock = within_squares(target), mean_cost(self.manipulator, costs), incumbent.clock
        clock.charge(self._growth(width))
        for configuration, wanted, price in self._beam(target.position, target.scene, costs, worth, width):
            if price < incumbent.cost:
                square, within = self.finish(wanted, target, costs, configuration, most, clock)
                cost = float(costs[modules, configuration].sum())
                if within and cost < incumbent.cost and target.met(configuration):
                    incumbent.offer(configuration, cost, square)

    def finish(
        self,
        wanted: Vector,
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

        Args:
            target: the goal.
            costs: the secondary criterion, shape (B, Kmax).
            best: returned with `most` if there is none, shape (B,).
            most: squared error.
            clock: of the search.
        """
        towards, until = self._towards(target.position), clock.now() + BEAM_TIME
        clock.charge(self._growth(BEAM))
        for configuration, wanted, _ in self._beam(towards, target.scene, costs, 1.0, BEAM):
            square, _ = self.finish(wanted, target, costs, configuration, most, clock)
            if square < most:
                return configuration, square
            if clock.now() > until:
                break
        return best, most

    def _beam(
        self, goal: Vector, scene: Scene | None, costs: StageCosts, worth: float, width: int
    ) -> Iterator[tuple[Configuration, Vector, float]]:
        """Yields the configurations of a beam search below the table, the goal in frame F_root, and the costs so far.

        Args:
            goal: position in frame F_0, shape (3,).
            scene: obstacles.
            costs: cost of each module's states, shape (B, Kmax).
            worth: cost that one unit of the measure is worth.
            width: width of the beam.
        """
        configurations = np.zeros((width, len(self.manipulator.modules)), dtype=np.int64)
        beam = Beam(configurations, np.zeros((width, 3)), np.zeros(width))
        count = beam_search(goal, self._tables(costs), worth, beam, scene)
        yield from zip(configurations[:count], beam.wanted, beam.costs.tolist(), strict=False)

    def _growth(self, width: int) -> float:
        """Returns the price of a beam of some width."""
        return GROWN * width * int(self.manipulator.states[: self.table.root].sum())

    def _tables(self, costs: StageCosts) -> DescentTables:
        """Returns what a descent to the distal table's root goes by."""
        return DescentTables(self._arm, self._levels, costs, self.table.root)

    def _towards(self, goal: Vector) -> Vector:
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
        wanted = descend((x, y, z), self._tables(costs), thresholds, configuration, target.scene)
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
