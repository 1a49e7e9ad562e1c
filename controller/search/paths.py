"""Paths of probability: the densities' descent from the base, finished by the exact distal table."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.scene import Scene
from controller.search.descent import beam_search, descend
from controller.search.distal_table import Wanted, build_distal_table, finish
from controller.search.method import (
    PaperMethod,
    Penalties,
    Variant,
    contraction,
    fewest_extended,
    fewest_switches,
    indifferent,
    mean_cost,
    similarity,
)
from controller.search.solution import Incumbent
from controller.search.target import Target
from controller.workspace.densities import Densities
from controller.workspace.reachability import levels_of, tables_of

Vector = NDArray[np.float64]

# The primary criterion's threshold: as many configurations must be expected to end within the tolerance. The first asks
# little, to leave the secondary criterion room; the next is tried where the one before misses the tolerance; the last,
# which nothing reaches, makes the search POP.
ENOUGH: tuple[float, ...] = (30.0, 1_000.0, 10_000.0, np.inf)

BEAM, BEAM_TIME = 64, 0.05  # width, and time [s] for its ends, if descents end among obstacles


class Paths:
    """POP and IPOP of one manipulator, and a beam search; holds the exact table of the last modules."""

    def __init__(self, manipulator: Manipulator, densities: Densities) -> None:
        """Builds the table."""
        self.manipulator = manipulator
        self.densities = densities
        self.table = build_distal_table(manipulator)
        self._arm, self._levels = tables_of(manipulator), levels_of(densities)
        self._edge = densities.edge()

    def follow(self, target: Target, previous: Configuration, method: PaperMethod | Variant) -> Configuration:
        """Returns the first configuration within the tolerances as the threshold rises, else the nearest seen.

        Among obstacles only configurations within the tolerances are sought at first, also by a beam search, and the
        nearest in the end; `previous` if all paths are blocked.

        Args:
            target: in frame F_0.
            previous: configuration to stay close to, shape (B,).
            method: the algorithm, and for IPOP the secondary criterion.
        """
        best, aim, ladder = previous, target, ENOUGH
        most = least = np.inf if target.scene is None else within_squares(target)
        if method == "pop":
            aim, ladder = replace(target, tolerance=0.0), (np.inf,)  # the nearest
            penalties = indifferent(self.manipulator)
        elif method == "ipop-previous":
            penalties = similarity(self.manipulator, previous)
        elif method == "ipop-contracted":
            penalties = contraction(self.manipulator)
        elif method == "ipop-fewest-switches":
            penalties = fewest_switches(self.manipulator, previous)
        else:
            penalties = fewest_extended(self.manipulator)
        for enough in ladder:
            configuration, square, within = self._descend(aim, penalties, enough, most)
            if square < least or within:
                best, least = configuration, square
            if within:
                break
        if least == most and target.scene is not None:
            best, least = self._around(aim, penalties, best, most)
        if least == most and target.scene is not None:
            configuration, square, _ = self._descend(aim, penalties, np.inf, np.inf)
            best = configuration if square < np.inf else self._around(aim, penalties, best, np.inf)[0]
        return best

    def widen(self, target: Target, costs: Penalties, width: int, incumbent: Incumbent) -> None:
        """Offers the configurations of a beam search.

        Args:
            target: in frame F_0.
            costs: of every module's states, shape (B, Kmax).
            width: how many partial configurations are kept at each module.
            incumbent: the best so far.
        """
        modules = np.arange(len(self.manipulator.modules))
        most, worth = within_squares(target), mean_cost(self.manipulator, costs)
        for configuration, wanted, price in self._beam(target.position, target.scene, costs, worth, width):
            if price < incumbent.cost:
                square, within = self.finish(wanted, target, costs, configuration, most)
                cost = float(costs[modules, configuration].sum())
                if within and cost < incumbent.cost and target.met(configuration):
                    incumbent.offer(configuration, cost, square)

    def finish(
        self,
        wanted: Vector,
        target: Target,
        penalties: Penalties,
        configuration: Configuration,
        most: float = np.inf,
    ) -> tuple[float, bool]:
        """Fixes the modules that the densities leave, for a position (3,) in frame F_root, see distal_table.finish."""
        asked = Wanted(target.rotation, target.tolerance, target.exact_chord, target.weight)
        found: tuple[float, bool] = finish(
            wanted, asked, most, self.table, penalties, self._arm, configuration, target.scene
        )
        return found

    def _around(
        self, target: Target, penalties: Penalties, best: Configuration, most: float
    ) -> tuple[Configuration, float]:
        """Returns the first of a beam's configurations that is nearer than `most`, and the square, or `best`.

        Args:
            target: in frame F_0.
            penalties: the secondary criterion, shape (B, Kmax).
            best: if there is none, shape (B,).
            most: the square to be bettered.
        """
        towards, until = self._towards(target.position), time.perf_counter() + BEAM_TIME
        for configuration, wanted, _ in self._beam(towards, target.scene, penalties, 1.0, BEAM):
            square, _ = self.finish(wanted, target, penalties, configuration, most)
            if square < most:
                return configuration, square
            if time.perf_counter() > until:
                break
        return best, most

    def _beam(
        self, goal: Vector, scene: Scene | None, costs: Penalties, worth: float, width: int
    ) -> Iterator[tuple[Configuration, Vector, float]]:
        """Gives the configurations of a beam up to the table, the goal in the frame there, and their costs so far.

        Args:
            goal: position in frame F_0, shape (3,).
            scene: obstacles.
            costs: of every module's states, shape (B, Kmax).
            worth: cost that one more unit of the measure makes up for.
            width: how many partial configurations are kept at each module.
        """
        configurations = np.zeros((width, len(self.manipulator.modules)), dtype=np.int64)
        wanted, prices = np.zeros((width, 3)), np.zeros(width)
        count = beam_search(
            goal,
            self._arm,
            self._levels,
            costs,
            worth,
            self.table.root,
            configurations,
            wanted,
            prices,
            scene,
        )
        yield from zip(configurations[:count], wanted, prices.tolist(), strict=False)

    def _towards(self, goal: Vector) -> Vector:
        """Returns `goal`, or, where it is outside the box of W_0, the centre (3,) of the nearest pixel that has points.

        Every density is as good as zero out there: distances to their boxes would lead the descent astray.
        """
        low, high = self.densities.box(0)
        if np.all((low <= goal) & (goal <= high)):
            return goal
        return np.asarray(self._edge[np.argmin(((self._edge - goal) ** 2).sum(axis=1))])

    def _descend(
        self, target: Target, penalties: Penalties, enough: float, most: float
    ) -> tuple[Configuration, float, bool]:
        """Returns the configuration of one descent, the square by which it misses, and whether it is within.

        Where it does not miss by less than `most`, that is returned, and the configuration is none.
        """
        configuration = np.zeros(len(self.manipulator.modules), dtype=np.int64)
        wanted = descend(
            self._towards(target.position),
            self._arm,
            self._levels,
            penalties,
            self._thresholds(target, enough),
            self.table.root,
            configuration,
            target.scene,
        )
        if math.isnan(wanted[0]):
            return configuration, most, False
        square, within = self.finish(np.array(wanted), target, penalties, configuration, most)
        return configuration, square, within

    def _thresholds(self, target: Target, enough: float) -> NDArray[np.float64]:
        """Returns, for each level, the ln of a pixel's count at which `enough` points are within the tolerances.

        Orientations are taken for evenly spread.
        """
        if np.isinf(enough):
            return np.full(len(self.densities.pixels), np.inf)
        tolerance = target.tolerance
        ball = math.pi * tolerance**2 if self.manipulator.planar else 4 / 3 * math.pi * tolerance**3
        ball = max(ball * target.share, 1e-300)
        volumes = self.densities.pixels**self.manipulator.dimension
        return np.log(np.maximum(enough * volumes / ball, 1.0))


def within_squares(target: Target) -> float:
    """Returns what is more than any square, see Target, of what is within the tolerances, by little."""
    return target.tolerance**2 * 1.001 + (target.weight**2 * target.chord if target.oriented else 0.0)
