"""Fewest switches: the cheapest configuration within the tolerances, and a proof that no cheaper one exists.

The stages, each of which improves the incumbent and what is proven of it: two lists, matched in the middle; IPOP's
answer, if the lists yield no proof; branch and bound for planar arms, and four lists, which find
or exclude what two lists leave out; beam searches, and two lists around the incumbent, while time is left.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.scene import collides
from controller.search.branch_and_bound import BranchAndBound
from controller.search.four_list import FourList, Proof
from controller.search.frame_rows import motions
from controller.search.matching import put
from controller.search.method import distances
from controller.search.paths import Paths
from controller.search.segment import Sets, build_segment, room
from controller.search.solution import Incumbent
from controller.search.target import Target, search_radius
from controller.search.two_list import TwoList, rows
from controller.workspace.hull import Hull

Array = NDArray[np.float64]

NEAR = 1 << 14  # rows of a half, for a beginning
WIDE = 1 << 16  # for what the near lists leave out, if the incumbent costs not much more
LADDER = (NEAR, WIDE, 1 << 18)  # rows of lists around the incumbent
GRID = {2: 256, 3: 32}  # near pairs are looked for within the points' extent over so many
EASY = 1.5  # times what the near lists leave out: four lists prove what costs less sooner than maps are made
REST, REST_FOUND = 0.5, 0.2  # parts of the time that branch and bound leaves at first; the second with an incumbent
BEAMS = (32, 128, 512)  # widths, the next if there is time
FAR = 1.0, 1.2  # times what the near lists leave out in both halves: beam searches precede a proof of what costs more


@dataclass(frozen=True, eq=False)
class Problem:
    """A goal and where it is asked for from.

    Attributes:
        target: the goal.
        seed: the configuration that costs nothing, shape (B,).
        costs: of every state of every module, at least 0, shape (B, Kmax).
        patience: `time.perf_counter()` up to which to search if nothing is within the tolerances before.
        hopeless: whether it is known that nothing is.
    """

    target: Target
    seed: Configuration
    costs: Array
    patience: float
    hopeless: bool = False


class MinimumSwitch:
    """The search of one manipulator, with the memory for its tables.

    Args:
        manipulator: the arm.
        hull: of its tips.
        paths: of its densities.
    """

    def __init__(self, manipulator: Manipulator, hull: Hull, paths: Paths) -> None:
        self._m, self._hull, self._paths = manipulator, hull, paths
        self._near, self._wide = TwoList(manipulator, NEAR), TwoList(manipulator, LADDER[-1])
        self._four = FourList(manipulator, self._near.cut)
        self._tree = BranchAndBound(manipulator, hull) if manipulator.planar else None
        self._nearest = Nearest(manipulator, self._wide)
        self._row_time = 0.0
        self._proof: Proof | None = None

    def claim(self) -> None:
        """Has the system hand out memory now, not in the middle of a search with a deadline.

        Only searches that take long list more than the first rung of LADDER; they have the time to wait for memory.
        """
        self._near.claim()
        self._wide.claim(LADDER[0])
        self._four.claim()
        self._nearest.claim()
        if self._tree is not None:
            self._tree.claim()

    def expect(self, seed: Configuration, costs: Array, tolerance: float) -> Iterator[None]:
        """Lists and sorts, step by step, what the search of a position begins with; repeating it costs nothing."""
        radius = search_radius(self._m, tolerance)
        self._near.list(seed, costs, costs)
        yield
        self._near.index(radius, np.inf)
        yield
        self._four.list(seed, costs)
        yield
        self._four.index(radius, np.inf)
        if self._tree is not None:
            for _ in self._tree.maps.steps(costs, radius):
                yield

    def improve(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs the stages until the incumbent is proven or its time is over."""
        stages: tuple[Callable[[Problem, Incumbent], None], ...] = (
            self._two_lists,
            self._outside,
            self._ipop,
            self._branch_and_bound,
            self._far,
            self._four_lists,
            self._approach,
            self._around,
            self._four_lists,
            self._beams,
            self._branch_and_bound,
        )
        self._proof = None
        if self._tree is not None:
            self._tree.begin()
        for stage in stages:
            if not incumbent.proven:
                stage(problem, incumbent)
        if incumbent.cost == np.inf and not incumbent.proven and problem.patience > incumbent.until:
            incumbent.until = problem.patience
            for stage in (self._approach, self._around, self._branch_and_bound, self._four_lists, self._beams):
                if not incumbent.proven:
                    stage(problem, incumbent)
        if incumbent.cost == np.inf:
            if incumbent.square == np.inf:
                self._ipop(problem, incumbent)
            self._nearest.improve(problem.target, incumbent)

    def repair(self, target: Target, incumbent: Incumbent) -> None:
        """Offers a configuration within the tolerances near the incumbent's, or else the nearest found."""
        free = np.zeros(self._m.bits.shape[:2])
        problem = Problem(target, incumbent.configuration, free, incumbent.until)
        self._nearest.improve(target, incumbent)
        for most in LADDER:
            if incumbent.cost == np.inf:
                self._wander(problem, incumbent, most)

    def _two_lists(self, problem: Problem, incumbent: Incumbent) -> None:
        """Matches the halves near the seed."""
        if problem.hopeless:
            incumbent.prove(np.inf)
        elif not incumbent.late:
            self._near.list(problem.seed, problem.costs, problem.costs)
            complete, bound = self._near.match(problem.target, incumbent)
            incumbent.prove(bound)
            if complete:
                self._proof = Proof(self._four, problem.target, problem.seed)

    def _outside(self, problem: Problem, incumbent: Incumbent) -> None:
        """Proves that a goal outside the hull of all tips is unreachable."""
        target = problem.target
        if incumbent.cost == np.inf and self._hull.excludes(target.position, target.tolerance):
            incumbent.prove(np.inf)

    def _ipop(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers IPOP's answer if nothing better is known."""
        if incumbent.cost < np.inf:
            return
        target, modules = problem.target, np.arange(len(problem.seed))
        configuration = self._paths.follow(target, problem.seed, "ipop-fewest-switches")
        clear = target.scene is None or not collides(target.scene, configuration)
        served = clear and target.met(configuration)
        cost = float(problem.costs[modules, configuration].sum()) if served else np.inf
        square = target.square(self._m.tip(configuration)) if clear else np.inf
        incumbent.offer(configuration, cost, square)

    def _branch_and_bound(self, problem: Problem, incumbent: Incumbent) -> None:
        """Searches the tree, the first time in a part of the time that is left, then to the end."""
        tree = self._tree
        if tree is None or problem.hopeless or incumbent.late:
            return
        waiting = tree.map_time(problem.target, problem.costs)
        if waiting > 0.0 and incumbent.cost <= EASY * min(self._near.lower.unexplored, self._near.upper.unexplored):
            self._four_lists(problem, incumbent)
        left = incumbent.remaining()
        if not incumbent.proven and left > waiting:
            rest = 0.0 if tree.begun else REST_FOUND if incumbent.cost < np.inf else REST
            until = incumbent.until - rest * left
            tree.run(problem.target, problem.seed, problem.costs, incumbent, until)

    def _four_lists(self, problem: Problem, incumbent: Incumbent) -> None:
        """Proves what the two lists leave out to be no better, or finds it.

        Lists more if the proof has come to what the near lists leave out in both halves.
        """
        proof, near, wide = self._proof, self._near, self._wide
        if proof is None or incumbent.over:
            return
        starts = near.lower.unexplored, near.upper.unexplored
        if not proof.begun:
            self._four.list(problem.seed, problem.costs)
            proof.add(near, (0.0, 0.0), starts, incumbent.cost)
        proof.run(incumbent)
        if not incumbent.over and proof.rest == sum(starts) and incumbent.bound >= proof.rest:
            most = WIDE if incumbent.cost <= FAR[1] * proof.rest else LADDER[-1]
            self._list(problem.seed, problem.costs, problem.costs, most)
            proof.add(wide, starts, (starts[0], wide.upper.unexplored), incumbent.cost)
            proof.run(incumbent)

    def _far(self, problem: Problem, incumbent: Incumbent) -> None:
        """Improves an incumbent that costs too much for a quick proof, by beam searches and halves around it."""
        if incumbent.late:
            return
        for width, share in zip(BEAMS, FAR, strict=False):
            most = share * (self._near.lower.unexplored + self._near.upper.unexplored)
            if most < incumbent.cost < np.inf and not incumbent.late:
                self._paths.widen(problem.target, problem.costs, width, incumbent)
                self._wander(problem, incumbent, NEAR)

    def _approach(self, problem: Problem, incumbent: Incumbent) -> None:
        """Brings the tip nearer: what is near is near to what is within the tolerances, too."""
        if incumbent.cost == np.inf:
            self._release()
            self._nearest.improve(problem.target, incumbent)

    def _around(self, problem: Problem, incumbent: Incumbent) -> None:
        """Matches halves around the incumbent; longer lists while nothing is within the tolerances."""
        for most in LADDER:
            self._wander(problem, incumbent, most)
            if incumbent.cost < np.inf or not problem.target.hard:
                break

    def _beams(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers what wider beam searches find, and halves around it."""
        seconds = 0.0
        for width in BEAMS[1:]:
            if incumbent.proven or incumbent.remaining() < seconds:
                break
            began = time.perf_counter()
            self._paths.widen(problem.target, problem.costs, width, incumbent)
            seconds = 6.0 * (time.perf_counter() - began)
            self._wander(problem, incumbent, NEAR)

    def _release(self) -> None:
        """Ends a proof that goes by the wide lists, which are about to be overwritten."""
        if self._proof is not None and self._proof.rest > self._near.lower.unexplored + self._near.upper.unexplored:
            self._proof = None

    def _list(self, seed: Configuration, distances: Array, costs: Array, most: int) -> None:
        """Lists the wide halves, and notes how long a row takes, with room."""
        began = time.perf_counter()
        self._wide.list(seed, distances, costs, most)
        count = len(self._wide.lower.costs) + len(self._wide.upper.costs)
        self._row_time = 4.0 * (time.perf_counter() - began) / count

    def _wander(self, problem: Problem, incumbent: Incumbent, most: int) -> None:
        """Matches halves around the incumbent again and again, until it is the best near itself."""
        self._release()
        while incumbent.remaining() > most * self._row_time:
            seed, cost = incumbent.configuration, incumbent.cost
            self._list(seed, distances(self._m, seed), problem.costs, most)
            self._wide.match(problem.target, incumbent)
            if incumbent.cost >= cost:
                break


class Nearest:
    """Brings the tip nearer from a configuration on, by changes of few actuators at a time.

    Args:
        manipulator: the arm.
        two: memory that may be overwritten.
    """

    def __init__(self, manipulator: Manipulator, two: TwoList) -> None:
        self._m, self._motions, self._two = manipulator, motions(manipulator), two
        self._free = np.zeros(manipulator.bits.shape[:2])
        self._rows = room(rows(manipulator, 0, len(manipulator.modules), NEAR), self._motions.shape[1])

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        self._rows.claim()

    def improve(self, target: Target, incumbent: Incumbent) -> None:
        """Offers nearer configurations to an incumbent of infinite cost until its time is over, nearly."""
        seconds = 0.0
        while incumbent.remaining() > 1.5 * seconds:
            began, before = time.perf_counter(), incumbent.square
            self._change(target, incumbent)
            self._pair(target, incumbent)
            seconds = time.perf_counter() - began
            if incumbent.square >= before * (1 - 1e-9):
                break

    def _change(self, target: Target, incumbent: Incumbent) -> None:
        """Offers the nearest of all that differ in few actuators, wherever they are."""
        seed = incumbent.configuration
        away = distances(self._m, seed)
        count = len(self._m.modules)
        sets = Sets(self._motions, self._m.states, seed, away, self._free)
        segment = build_segment(sets, self._rows, 0, count)
        squares, side = target.squares(segment.frames), segment.side()
        nearer = np.flatnonzero(squares < incumbent.square)
        for row in nearer[np.argsort(squares[nearer])].tolist():
            configuration = seed.copy()
            put(configuration, seed, side, row)
            if target.scene is None or not collides(target.scene, configuration):
                incumbent.offer(configuration, np.inf, float(squares[row]))
                return

    def _pair(self, target: Target, incumbent: Incumbent) -> None:
        """Offers the nearest of all that differ in few actuators of either half, if it is very near."""
        two, size = self._two, self._m.dimension
        two.list(incumbent.configuration, distances(self._m, incumbent.configuration), self._free, NEAR)
        extent = float(np.ptp(two.upper.frames[:, :size], axis=0).max())
        within = min(float(np.sqrt(incumbent.square)), extent / GRID[size])
        if within == 0.0:
            return
        near = Incumbent(incumbent.configuration, incumbent.until)
        near.offer(incumbent.configuration, 0.0, incumbent.square)
        two.match(replace(target, tolerance=within, angle_tolerance=math.inf), near)
        incumbent.offer(near.configuration, np.inf, near.square)
