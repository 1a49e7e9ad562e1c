"""The merit of an arm: which targets it reaches, with how many switches, and still with one actuator stuck."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.locked import LockedStates
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.search.search_time import SearchTime, search_effort
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities

Array = NDArray[np.float64]

LEVEL_PIXELS = 1 << 15  # of each intermediate workspace: densities only begin searches and skip targets here
PIXELS = 2.0  # a target without a tip within its tolerance and this many pixels is not searched


class Target(NamedTuple):
    """Where the tip shall be.

    Attributes:
        goal: position in the world, shape (2,) or (3,), or frame, shape (4, 4).
        tolerance: greatest distance of the tip; None: the arm's.
        angle_tolerance: greatest angle of the tip [rad]; None: the arm's. Positions have none.
        weight: of this target among the others.
    """

    goal: Array
    tolerance: float | None = None
    angle_tolerance: float | None = None
    weight: float = 1.0

    @property
    def position(self) -> Array:
        """Position in the world, shape (2,) or (3,)."""
        return self.goal[:3, 3] if self.goal.ndim == 2 else self.goal


class Effort(NamedTuple):
    """Work of the search for one target, and of one that is missed, in units of effort."""

    search: float
    missed: float

    @property
    def allowed(self) -> SearchTime:
        return search_effort(self.search, self.missed)


class Judged(NamedTuple):
    """An arm to judge: `locked` actuators (A,), and the chain without the states that they exclude."""

    arm: Arm
    manipulator: Manipulator
    locked: LockedStates


def judged(arm: Arm) -> Judged:
    """Returns the arm of a file; actuators that the file declares stuck are locked."""
    return Judged(arm, arm.reduced, arm.locked)


class Merit(NamedTuple):
    """What an arm is worth for targets.

    Attributes:
        reached: weighted share of the targets that the arm reaches within the tolerances, clear of obstacles.
        switches: weighted mean of the switches from target to target; a missed target costs all actuators.
        stuck: weighted share, over targets, actuators and their two states, of the targets that the arm reaches with
            this actuator in this state; None if it was not asked for.
        actuators: number of actuators.
        length: upper bound of the distance of the tip from the base.
        reached_error, switches_error: standard errors of `reached` and `switches`, if targets are drawn at random.
        proven: number of targets for which the fewest switches, or that the target is out of reach, are proven.
        solutions: of each target; None: it was not searched, because no tip is near. A search starts at the last
            configuration within the tolerances, the first at home.
    """

    reached: float
    switches: float
    stuck: float | None
    actuators: int
    length: float
    reached_error: float
    switches_error: float
    proven: int
    solutions: tuple[Solution | None, ...]


class Searcher(NamedTuple):
    """A solver of an arm without tables in the cache, its densities, and the configuration that it starts from."""

    solver: Solver
    home: Configuration
    tolerances: tuple[float, float]

    def target(self, target: Target) -> SearchTarget:
        """Returns a target with its tolerances."""
        angle = math.inf if target.goal.ndim == 1 else target.angle_tolerance or self.tolerances[1]
        return self.solver.target(target.goal, target.tolerance or self.tolerances[0], angle)


def searcher_of(own: Judged, obstacles: Obstacles = NONE, densities: Densities | None = None) -> Searcher:
    """Returns a searcher of an arm among further obstacles; its densities are computed if None."""
    arm, chain, _ = own
    counts = densities or map_densities(chain, arm.pixel, min(arm.level_pixels, LEVEL_PIXELS))
    solver = Solver(chain, counts, weights_of(arm), arm.clearance(chain, obstacles))
    return Searcher(solver, np.zeros(len(chain.modules), dtype=np.int64), (arm.tolerance, arm.angle_tolerance))


def searched(searcher: Searcher, targets: Sequence[Target], effort: Effort) -> Iterator[Solution | None]:
    """Yields the solution of each target, from the last configuration that reached one; None if no tip is near."""
    start = searcher.home
    for target in targets:
        goal = searcher.target(target)
        if far(searcher.solver, goal):
            yield None
            continue
        found = searcher.solver.solve(goal, start, timeout=effort.allowed)
        if found.within_tolerance:
            start = found.configuration
        yield found


def far(solver: Solver, goal: SearchTarget) -> bool:
    """Returns whether no pixel with tips is near a goal."""
    densities, size = solver.densities, solver.manipulator.dimension
    pixel, level = float(densities.pixels[0]), densities.level(0)
    place = (goal.position - densities.references[0]) / pixel
    shape = np.array(level.shape[::-1])
    inside = np.clip(np.round(place), 0, shape - 1)
    outside = float(np.linalg.norm((place - inside)[:size])) * pixel
    x, y, z = inside.astype(int)
    return bool(max(outside, -float(level[z, y, x])) > goal.tolerance + PIXELS * pixel)


def merit_of(own: Judged, targets: Sequence[Target], solutions: Sequence[Solution | None]) -> Merit:
    """Returns the merit of an arm by the solutions of all targets, without `stuck`."""
    weights = np.array([target.weight for target in targets])
    met = [found is not None and found.within_tolerance for found in solutions]
    most = len(own.manipulator.actuators)
    switches = [found.switches if found is not None and found.within_tolerance else most for found in solutions]
    reached, reached_error = mean(np.array(met, dtype=float), weights)
    each, each_error = mean(np.array(switches, dtype=float), weights)
    proven = sum(found is not None and found.certificate in ("optimal", "unreachable") for found in solutions)
    length = own.manipulator.length
    return Merit(reached, each, None, most, length, reached_error, each_error, proven, tuple(solutions))


def mean(values: Array, weights: Array) -> tuple[float, float]:
    """Returns the weighted mean of values (n,), and its standard error."""
    own, middle = weights / weights.sum(), float(weights @ values / weights.sum())
    spare = len(values) / max(len(values) - 1, 1)
    return middle, float(np.sqrt(spare * (own**2 @ (values - middle) ** 2)))
