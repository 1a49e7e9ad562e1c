"""IPOP on densities with orientation: the descent in Python, finished by the product's exact tail."""

import math
from dataclasses import dataclass

import numpy as np

from hyperbit.controller.manipulator.frames import Frame, inverse
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.method import StageCosts, stage_costs
from hyperbit.controller.search.paths import ENOUGH, Paths
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.workspace.densities import Densities
from tests.benchmarks.search.oriented_densities.oriented import OrientedDensities
from tests.benchmarks.search.oriented_densities.oriented_mapping import map_oriented


@dataclass(frozen=True, eq=False)
class Problem:
    """Attributes: the arm, its densities with orientation, and the paths whose tail finishes."""

    manipulator: Manipulator
    densities: OrientedDensities
    paths: Paths


def prepare(manipulator: Manipulator, densities: Densities, level_pixels: int, weight: float) -> Problem:
    """Maps with orientation, at most `level_pixels` with points a level."""
    pixel = manipulator.length / 400
    return Problem(manipulator, map_oriented(manipulator, pixel, level_pixels, weight), Paths(manipulator, densities))


def solve(problem: Problem, target: SearchTarget, previous: Configuration) -> Configuration:
    """Returns the first configuration within the tolerances of a target in F_0, or the nearest of all thresholds."""
    costs = stage_costs("ipop-fewest-switches", problem.manipulator, previous)
    best, least = previous, np.inf
    for enough in ENOUGH:
        configuration = np.zeros(len(previous), dtype=np.int64)
        frame = descend(problem, target, costs, enough, configuration)
        position = np.ascontiguousarray(frame[:3, 3])
        square, within = problem.paths.finish(position, target, costs, configuration)
        if square < least or within:
            best, least = configuration, square
        if within:
            break
    return best


def descend(
    problem: Problem, target: SearchTarget, costs: StageCosts, enough: float, configuration: Configuration
) -> Frame:
    """Fixes the modules up to the tail's root; returns the goal in frame F_root."""
    m, d, frame = problem.manipulator, problem.densities, target.frame
    ball = math.pi * target.tolerance**2 if m.planar else 4 / 3 * math.pi * target.tolerance**3
    ball *= target.share * (2 * math.pi if m.planar else 8 * math.pi**2)
    for i in range(problem.paths.table.root):
        onward = inverse(m.frames[i, : m.states[i]]) @ frame
        values = d.at(i + 1, onward)
        threshold = math.log(max(enough * d.volume(i + 1) / ball, 1.0)) if enough < np.inf else np.inf
        good = values >= threshold
        # The least cost, then the greatest value; the greatest value where no state is good.
        j = int(np.lexsort((-values, np.where(good, costs[i, : m.states[i]], np.inf)))[0])
        configuration[i], frame = j, onward[j]
    return frame
