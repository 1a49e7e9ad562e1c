"""Minimum switch: the cheapest configuration within the tolerances, with a proof that no cheaper one exists.

The stages improve the incumbent and its lower bound: two lists, matched in the middle; IPOP, if the lists yield no
configuration; branch and bound for planar arms, or lists of neighbours for long ones; four lists, which find or exclude
what two lists leave out; beam searches, each followed by two lists around the incumbent, until the deadline.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import collides
from hyperbit.controller.search.branch_and_bound import BranchAndBound
from hyperbit.controller.search.clock import CHANGED, INDEXED, LISTED, WALL, Clock
from hyperbit.controller.search.descent.paths import Paths
from hyperbit.controller.search.lists.four_list import FourList, FourListProof
from hyperbit.controller.search.lists.matching import load_matchers, put
from hyperbit.controller.search.lists.segment import Sets, build_segment, motions
from hyperbit.controller.search.lists.two_list import ListSizes, TwoList, room_for
from hyperbit.controller.search.method import distances
from hyperbit.controller.search.neighbours.chain import Chain, chain_of
from hyperbit.controller.search.neighbours.leaps import Leaps
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import Problem, SearchTarget, search_radius
from hyperbit.controller.workspace.hull import Hull

Array = NDArray[np.float64]

GRID = {2: 256, 3: 32}  # extent of the points over the greatest distance of a pair, by dimension
EASY = 1.5  # below this multiple of the unexplored cost, four lists give a proof sooner than new maps
# Share of the time that branch and bound leaves to others at first: for a pose, or without an incumbent; for a position
# with one. A pose has a position's map and a heading's, which exclude less than one map of both would.
REST, REST_FOUND = 0.4, 0.2
BEAMS = (32, 128, 512)  # widths of beam searches, in order
MARGIN = 4.0  # of the estimated time for a row
FAR = 1.0, 1.2  # above these multiples of the unexplored cost of pairs, beam searches precede the proof


class MinimumSwitch:
    """The minimum-switch search of one manipulator, with its memory."""

    def __init__(self, manipulator: Manipulator, hull: Hull, paths: Paths, chain: Chain, sizes: ListSizes) -> None:
        load_matchers(manipulator.planar)
        self._sizes = sizes
        self._m, self._hull, self._paths = manipulator, hull, paths
        self._near, self._wide = (TwoList(manipulator, most, sizes.matched) for most in (sizes.near, sizes.widest))
        self._four = FourList(manipulator, self._near.cut, sizes)
        self._tree = BranchAndBound(manipulator, hull) if manipulator.planar else None
        by_switches = chain_of(manipulator, manipulator.per_module(np.ones(len(manipulator.actuators))), 1.0, True)
        self._nearest = Nearest(manipulator, self._wide, sizes.near)
        self._leaps = Leaps(chain, by_switches, sizes)
        self._row_time = 0.0
        self._proof: FourListProof | None = None

    def claim(self) -> None:
        """Touches the memory, so that no search waits for page faults.

        Only long searches list more than near lists; they can wait for their memory.
        """
        self._near.claim()
        self._wide.claim(self._sizes.near)
        self._four.claim()
        self._nearest.claim()
        if self._tree is not None:
            self._tree.claim()

    def expect(self, seed: Configuration, costs: Array, tolerance: float) -> Iterator[None]:
        """Prepares the lists and maps of a position search step by step. A repeated call returns at once."""
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
        """Runs the stages until the incumbent is proven or the deadline passes, which the gap may extend."""
        tree = self._quick_proof, self._part_of_tree
        long = self._leaps.worthwhile
        near, leap = ((self._near_seed,), (self._far_from_seed, self._leap)) if long else ((), ())
        stages: tuple[Callable[[Problem, Incumbent], None], ...] = (
            self._two_lists,
            self._outside,
            self._ipop,
            *(near or tree),
            self._far,
            *leap,
            self._four_lists,
            self._beams,
            self._rest_of_tree,
        )
        self._proof = None
        if self._tree is not None:
            self._tree.begin()
        for stage in stages:
            if not incumbent.proven:
                stage(problem, incumbent)
        if not incumbent.proven and incumbent.extend():
            lists = () if self._proof is not None else (self._two_lists,)  # the first time may have been too short
            proofs = *tree, self._four_lists, self._beams, self._rest_of_tree
            for stage in (*lists, *near, *leap, *proofs):
                if not incumbent.over:
                    stage(problem, incumbent)
        if incumbent.cost == np.inf:
            if incumbent.square == np.inf:
                self._ipop(problem, incumbent)
            self._nearest.improve(problem.target, incumbent)

    def repair(self, target: SearchTarget, incumbent: Incumbent) -> None:
        """Offers a configuration within the tolerances near the incumbent, otherwise the nearest found."""
        free = np.zeros(self._m.bits.shape[:2])
        problem = Problem(target, incumbent.configuration, free)
        self._nearest.improve(target, incumbent)
        for most in self._sizes.ladder:
            if incumbent.cost == np.inf:
                self._wander(problem, incumbent, most)

    def _two_lists(self, problem: Problem, incumbent: Incumbent) -> None:
        if problem.unreachable:
            incumbent.prove(np.inf)
        elif not incumbent.late:
            self._near.list(problem.seed, problem.costs, problem.costs)
            incumbent.clock.charge(LISTED * self._near.count)
            complete, bound = self._near.match(problem.target, incumbent)
            incumbent.prove(bound)
            if complete:
                self._proof = FourListProof(self._four, problem.target, problem.seed)

    def _outside(self, problem: Problem, incumbent: Incumbent) -> None:
        """Proves that a goal outside the hull of all tips is unreachable."""
        target = problem.target
        if incumbent.cost == np.inf and self._hull.excludes(target.position, target.tolerance):
            incumbent.prove(np.inf)

    def _ipop(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers the configuration of IPOP if the incumbent has none within the tolerances."""
        if incumbent.cost < np.inf:
            return
        target = problem.target
        configuration = self._paths.follow(target, problem.seed, "ipop-fewest-switches", incumbent.clock)
        clear = target.scene is None or not collides(target.scene, configuration)
        served = clear and target.met(configuration)
        cost = problem.cost(configuration) if served else np.inf
        square = target.square(self._m.tip(configuration)) if clear else np.inf
        incumbent.offer(configuration, cost, square)

    def _quick_proof(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs the four lists before branch and bound if its maps are not ready and the incumbent is cheap."""
        tree = self._tree
        if tree is None or problem.unreachable or incumbent.late:
            return
        if tree.map_time(problem.target, problem.costs, incumbent.clock) == 0.0:
            return
        if incumbent.cost <= EASY * min(self._near.lower.unexplored, self._near.upper.unexplored):
            self._four_lists(problem, incumbent)

    def _part_of_tree(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs branch and bound for a part of the remaining time, so that other searches find what it does not."""
        easy = incumbent.cost < np.inf and not problem.target.oriented
        self._branch_and_bound(problem, incumbent, REST_FOUND if easy else REST)

    def _rest_of_tree(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs branch and bound until the deadline."""
        self._branch_and_bound(problem, incumbent, 0.0)

    def _branch_and_bound(self, problem: Problem, incumbent: Incumbent, rest: float) -> None:
        tree = self._tree
        if tree is None or problem.unreachable or incumbent.late:
            return
        left = incumbent.remaining()
        if left > tree.map_time(problem.target, problem.costs, incumbent.clock):
            tree.run(problem.target, problem.seed, problem.costs, incumbent, incumbent.until - rest * left)

    def _four_lists(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs the proof by four lists.

        If the proof reaches the pairs that the near lists leave out in both halves, longer lists extend it.
        """
        proof, near, wide = self._proof, self._near, self._wide
        if proof is None or incumbent.over:
            return
        starts = near.lower.unexplored, near.upper.unexplored
        if not proof.begun:
            self._four.list(problem.seed, problem.costs)
            incumbent.clock.charge((LISTED + INDEXED) * self._four.count)
            proof.add(near, (0.0, 0.0), starts, incumbent.cost)
        proof.run(incumbent)
        if not incumbent.over and proof.rest == sum(starts) and incumbent.bound >= proof.rest:
            most = self._sizes.wide if incumbent.cost <= FAR[1] * proof.rest else self._sizes.widest
            self._list(problem, problem.seed, problem.costs, most, incumbent.clock)
            proof.add(wide, starts, (starts[0], wide.upper.unexplored), incumbent.cost)
            proof.run(incumbent)

    def _near_seed(self, problem: Problem, incumbent: Incumbent) -> None:
        """Lists all that is near the seed."""
        if not problem.unreachable and not incumbent.late:
            self._leaps.prove(problem, incumbent)

    def _far_from_seed(self, problem: Problem, incumbent: Incumbent) -> None:
        """Lists what is farther from the seed, if nothing is found or time is left."""
        if not problem.unreachable and not incumbent.late:
            self._leaps.prove_deep(problem, incumbent)

    def _leap(self, problem: Problem, incumbent: Incumbent) -> None:
        """Lists what is near other configurations, for a part of the remaining time."""
        if not problem.unreachable and not incumbent.late:
            self._leaps.improve(problem, incumbent, incumbent.until - REST_FOUND * incumbent.remaining())

    def _far(self, problem: Problem, incumbent: Incumbent) -> None:
        """Improves an incumbent that costs too much for a quick proof: beam searches, and two lists around it."""
        if incumbent.late:
            return
        for width, share in zip(BEAMS, FAR, strict=False):
            most = share * (self._near.lower.unexplored + self._near.upper.unexplored)
            if most < incumbent.cost < np.inf and not incumbent.late:
                self._paths.widen(problem.target, problem.costs, width, incumbent)
                self._wander(problem, incumbent, self._sizes.near)

    def _beams(self, problem: Problem, incumbent: Incumbent) -> None:
        """Runs wider beam searches, each followed by two lists around the incumbent."""
        seconds, clock = 0.0, incumbent.clock
        for width in BEAMS[1:]:
            if incumbent.proven or incumbent.remaining() < seconds:
                break
            began = clock.now()
            self._paths.widen(problem.target, problem.costs, width, incumbent)
            seconds = 6.0 * (clock.now() - began)
            self._wander(problem, incumbent, self._sizes.near)

    def _release(self) -> None:
        """Ends a proof that uses the wide lists before they are overwritten."""
        if self._proof is not None and self._proof.rest > self._near.lower.unexplored + self._near.upper.unexplored:
            self._proof = None

    def _list(self, problem: Problem, seed: Configuration, distances: Array, most: int, clock: Clock) -> None:
        """Lists the wide halves around a seed (B,), and estimates the time for a row, with a margin."""
        began = WALL.now()
        self._wide.list(seed, distances, problem.costs, most)
        self._row_time = MARGIN * (WALL.now() - began) / self._wide.count
        clock.charge(LISTED * self._wide.count)

    def _wander(self, problem: Problem, incumbent: Incumbent, most: int) -> None:
        """Matches two lists around the incumbent repeatedly, until this does not improve it."""
        self._release()
        clock = incumbent.clock
        while incumbent.remaining() > most * clock.expected(self._row_time, MARGIN * LISTED):
            seed, cost = incumbent.configuration, incumbent.cost
            self._list(problem, seed, distances(self._m, seed), most, clock)
            self._wide.match(problem.target, incumbent)
            if incumbent.cost >= cost:
                break


class Nearest:
    """Local search for the nearest tip, by changes of few actuators at a time; overwrites the two lists."""

    def __init__(self, manipulator: Manipulator, two: TwoList, most: int) -> None:
        self._m, self._motions, self._two, self._most = manipulator, motions(manipulator), two, most
        self._free = np.zeros(manipulator.bits.shape[:2])
        self._rows = room_for(manipulator, 0, len(manipulator.modules), most)

    def claim(self) -> None:
        """Touches all memory, so that no search waits for page faults."""
        self._rows.claim()

    def improve(self, target: SearchTarget, incumbent: Incumbent) -> None:
        """Offers nearer configurations to an incumbent of infinite cost until its deadline is near."""
        seconds, clock = 0.0, incumbent.clock
        while incumbent.remaining() > 1.5 * seconds:
            began, before = clock.now(), incumbent.square
            self._change(target, incumbent)
            self._pair(target, incumbent)
            seconds = clock.now() - began
            if incumbent.square >= before * (1 - 1e-9):
                break

    def _change(self, target: SearchTarget, incumbent: Incumbent) -> None:
        """Offers the nearest of all configurations that differ in few actuators of any module."""
        seed = incumbent.configuration
        away = distances(self._m, seed)
        count = len(self._m.modules)
        sets = Sets(self._motions, self._m.states, seed, away, self._free)
        segment = build_segment(sets, self._rows, 0, count)
        incumbent.clock.charge(CHANGED * len(segment.costs))
        squares, side = target.squares(segment.frames), segment.side()
        nearer = np.flatnonzero(squares < incumbent.square)
        for row in nearer[np.argsort(squares[nearer])].tolist():
            configuration = seed.copy()
            put(configuration, seed, side, row)
            if target.scene is None or not collides(target.scene, configuration):
                incumbent.offer(configuration, np.inf, float(squares[row]))
                return

    def _pair(self, target: SearchTarget, incumbent: Incumbent) -> None:
        """Offers the nearest of all configurations that differ in few actuators of each half, if it is very near."""
        two, size = self._two, self._m.dimension
        two.list(incumbent.configuration, distances(self._m, incumbent.configuration), self._free, self._most)
        incumbent.clock.charge(LISTED * two.count)
        extent = float(np.ptp(two.upper.frames[:, :size], axis=0).max())
        within = min(float(np.sqrt(incumbent.square)), extent / GRID[size])
        if within == 0.0:
            return
        near = Incumbent(incumbent.configuration, incumbent.until, clock=incumbent.clock)
        near.offer(incumbent.configuration, 0.0, incumbent.square)
        two.match(replace(target, tolerance=within, angle_tolerance=math.inf), near)
        incumbent.offer(near.configuration, np.inf, near.square)
