"""Transitions among obstacles: each stage is clear in any order of its actuators, with no needless stages."""

import re
from collections.abc import Callable
from itertools import pairwise, permutations, product, repeat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans import point_by_point
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.detours import Detour, Detours, Graph
from hyperbit.controller.motion.stages.pacing import Blocked, Pace, Staged, Stager
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import box, sphere, together
from hyperbit.controller.obstacles.sweep import Sweep
from hyperbit.controller.refusals.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, planar_frames
from tests.obstacles.dense import Disc, any_shape, obstacles_of
from tests.obstacles.moving import arm, hinge, motion, room, truss

LEAD = 0.06
POINTS = 40

angles = st.floats(-1.5, 1.5)
parts = st.lists(
    st.builds(truss, st.sampled_from(["BC", "AD"]), st.just(0.2), st.just(0.2), st.just(0.26))
    | st.builds(hinge, angles, angles, st.floats(0.2, 0.4)),
    min_size=2,
    max_size=4,
)
around = st.lists(any_shape(2, planar_frames), min_size=1, max_size=3)
ELBOWS = [hinge(0.0, np.pi / 2, 1.0), hinge(0.0, -np.pi / 2, 1.0)]


def never() -> bool:
    """A detour is searched to the end, also on a busy machine."""
    return False


def staged_to(
    manipulator: Manipulator,
    pace: Pace,
    clearance: BodyClearance,
    before: np.ndarray,
    after: np.ndarray,
    available: float | None = None,
) -> Staged:
    """Stages of a transition; if no usual order is clear, those of a detour, which is searched to the end."""
    stager = Stager(manipulator, pace, Sweep(clearance))
    try:
        return stager.staged(before, after, available)
    except Blocked:
        if clearance.where(before) is not None:
            raise
        found = Detours(clearance, before, after[None], once=pace.rest > 0).search(never)
        if not isinstance(found, Detour):
            raise
        return stager.staged(before, after, available, detour=found.order)


def displacements(rng: np.random.Generator, before: np.ndarray, staged: Staged) -> np.ndarray:
    rows = [before, *staged.stages]
    return np.concatenate([motion(rng, a, b, 8) for a, b in pairwise(rows) for _ in range(3)])


@settings(max_examples=80, deadline=None)
@given(parts, planar_frames, around, st.sampled_from([0.0, 0.03]), st.none() | st.integers(1, 3), st.integers(0, 2**32))
def test_stages_touch_nothing_and_keep_to_the_bound(chain, base, regions_around, radius, inrush, seed):
    rng, manipulator = np.random.default_rng(seed), arm(chain, base)
    clearance = BodyClearance(manipulator, obstacles_of(regions_around), radius)
    before, after = (rng.integers(0, manipulator.states) for _ in range(2))
    pace, start = Pace(LEAD, inrush), manipulator.actuator_states(before)
    try:
        staged = staged_to(manipulator, pace, clearance, before, after)
    except Blocked:
        return
    assert staged.strict
    assert staged.stages[-1].tolist() == manipulator.actuator_states(after).tolist()
    switched = np.abs(np.diff(np.vstack([start, staged.stages]).astype(int), axis=0))
    assert (switched.sum(axis=1) <= (inrush or len(start))).all()
    assert (switched.sum(axis=0) % 2 == (start != staged.stages[-1])).all()
    assert room(chain, base, regions_around, displacements(rng, start, staged), POINTS, False)[0] >= radius


@settings(max_examples=100, deadline=None)
@given(parts, planar_frames, around, st.integers(0, 2**32))
def test_an_order_is_found_where_trying_all_finds_one(chain, base, regions_around, seed):
    rng, manipulator = np.random.default_rng(seed), arm(chain, base)
    clearance = BodyClearance(manipulator, obstacles_of(regions_around))
    sweep = Sweep(clearance)
    before = rng.integers(0, manipulator.states)
    start = manipulator.actuator_states(before)
    flip = rng.permutation(len(start))[: rng.integers(1, 5)]
    end = start.copy()
    end[flip] ^= 1

    def clear(order: tuple[int, ...]) -> bool:
        states = start.copy()
        for a in order:
            if sweep.first_collision(states, np.array([a])) is not None:
                return False
            states[a] ^= 1
        return True

    possible = any(clear(order) for order in permutations(flip))
    try:
        staged_to(manipulator, Pace(LEAD, rest=LEAD), clearance, before, manipulator.configuration(end))
    except Blocked:
        assert not possible
    else:
        assert possible


def test_a_roundabout_way_is_taken_where_no_order_serves_and_actuators_need_no_rest():
    chain = [hinge(0.0, 2.4, 1.0), hinge(0.0, 2.4, 1.0)]  # the second folds back while the first passes the post
    manipulator = arm(chain)
    post = BodyClearance(manipulator, sphere("disc 'post'", (0.29, 1.675), 0.1))
    before, after = np.array([0, 0]), np.array([1, 0])
    with pytest.raises(Blocked):
        staged_to(manipulator, Pace(LEAD, rest=0.1), post, before, after)
    staged = staged_to(manipulator, Pace(LEAD), post, before, after)
    assert staged.stages.tolist() == [[0, 1], [1, 1], [1, 0]]
    with pytest.raises(Blocked, match="a collision-free transition takes 3 stages, there is time for 2"):
        staged_to(manipulator, Pace(LEAD), post, before, after, 2 * LEAD)


def test_what_need_not_wait_does_not():
    manipulator = arm(ELBOWS)
    before, after = np.array([0, 0]), np.array([1, 1])
    far = Sweep(BodyClearance(manipulator, sphere("disc", (5.0, 5.0), 0.5)))
    near = Sweep(BodyClearance(manipulator, box("box", (0.0, 2.0), (0.4, 0.4))))
    free = Stager(manipulator, Pace(LEAD)).staged(before, after)
    assert Stager(manipulator, Pace(LEAD), far).staged(before, after).stages.tolist() == free.stages.tolist()
    staged = Stager(manipulator, Pace(LEAD), near).staged(before, after)
    assert staged.stages.tolist() == [[0, 1], [1, 1]]  # the elbow first
    with pytest.raises(Blocked, match=r"takes 2 stages, there is time for 1: module 2 is in box"):
        Stager(manipulator, Pace(LEAD), near).staged(before, after, LEAD)
    assert Stager(manipulator, Pace(LEAD), near).staged(before, after, 2 * LEAD).deviation == staged.deviation


def test_no_way_and_a_start_that_touches_are_named():
    manipulator = arm(ELBOWS)
    walls = together([box("box 'shelf'", (0.0, 2.0), (0.4, 0.4)), box("box 'table'", (1.0, -0.9), (0.4, 0.4))])
    with pytest.raises(Blocked, match=r"module 2 is in box '(shelf|table)'"):
        staged_to(manipulator, Pace(LEAD), BodyClearance(manipulator, walls), np.array([0, 0]), np.array([1, 1]))
    stands = Sweep(BodyClearance(manipulator, sphere("disc 'post'", (1.5, 0.0), 0.1)))
    with pytest.raises(Blocked, match="collides where it stands: module 2 is in disc 'post'"):
        Stager(manipulator, Pace(LEAD), stands).staged(np.array([0, 0]), np.array([1, 1]))


CHAIN = [truss("BC" if k % 2 == 0 else "AD", 0.2, 0.2, 0.25) for k in range(4)]
MANIPULATOR = arm(CHAIN)
EVERY = every_configuration(MANIPULATOR)
TIPS = MANIPULATOR.tips(EVERY)[:, :2, 3]


@pytest.fixture(scope="module")
def solver() -> Solver:
    return Solver(MANIPULATOR, map_densities(MANIPULATOR, 0.01, 10_000), list_whole=False)


def test_plans_take_the_next_configuration_where_there_is_no_way_to_the_cheapest(solver):
    rng, aside, refused = np.random.default_rng(3), 0, list[str]()
    for _ in range(60):
        centre = TIPS[rng.integers(len(TIPS))] + rng.normal(0, 0.1, 2)
        clearance = BodyClearance(MANIPULATOR, sphere("disc", centre, 0.06))
        own = solver.avoiding(clearance)
        free = EVERY[~clearance.blocked(EVERY)]
        before, goal = free[rng.integers(len(free))], MANIPULATOR.tip(free[rng.integers(len(free))])[:2, 3]
        try:
            found = PointByPoint(
                TransitionPlanner(own, through(np.zeros(1), goal[None], 0.03), Pace(LEAD, rest=LEAD)), "minimum-switch"
            ).plan(before)
        except Refusal as refusal:
            refused.append(str(refusal))
            continue
        staged, start = found.transitions[0], MANIPULATOR.actuator_states(before)
        cheapest = own.solve(own.target(goal, 0.03), before)
        aside += found.solutions[0].configuration.tolist() != cheapest.configuration.tolist()
        disc = [Disc(tuple(centre), 0.06)]
        assert room(CHAIN, np.eye(4), disc, displacements(rng, start, staged), POINTS, False)[0] >= 0
    assert aside >= 1
    assert len(refused) < 10
    assert all(
        re.match(r"waypoint 1, position: no collision-free transition .* module \d is in disc", each)
        for each in refused
    )


def test_a_plan_from_where_the_arm_touches_is_refused(solver):
    own = solver.avoiding(BodyClearance(MANIPULATOR, sphere("disc 'post'", MANIPULATOR.tip(EVERY[0])[:2, 3], 0.05)))
    with pytest.raises(Refusal, match=r"may not move from where it stands: module \d is in disc 'post'") as caught:
        PointByPoint(TransitionPlanner(own, through(np.zeros(1), TIPS[-1:], 0.03)), "minimum-switch").plan(EVERY[0])
    assert caught.value.code == INVALID_GOAL


def test_no_way_is_refused_naming_waypoint_module_and_region():
    manipulator = arm(ELBOWS)
    walls = together([box("box 'shelf'", (0.0, 2.0), (0.4, 0.4)), box("box 'table'", (1.0, -0.9), (0.4, 0.4))])
    solver = Solver(manipulator, map_densities(manipulator, 0.05, 10_000), clearance=BodyClearance(manipulator, walls))
    goal = manipulator.tip([1, 1])[:2, 3]
    with pytest.raises(Refusal) as caught:
        PointByPoint(TransitionPlanner(solver, through(np.zeros(1), goal[None], 0.01)), "minimum-switch").plan(
            np.array([0, 0])
        )
    assert caught.value.code == GOAL_TOLERANCE_VIOLATED
    form = r"waypoint 1, position: there is no collision-free transition to it, [^:]*: "
    assert re.fullmatch(form + r"module 2 is in box '(shelf|table)'", str(caught.value))
    assert [list(c) for c in product(range(2), repeat=2) if not solver.clearance.blocked([c])[0]] == [[0, 0], [1, 1]]


class Ended(Exception):
    """Nobody wants the plan any more."""


def test_a_search_for_a_detour_ends_when_its_caller_wants(solver):
    """In the middle of the detour, and through the whole planning of a point."""
    manipulator = arm(ELBOWS)
    walls = together([box("box 'shelf'", (0.0, 2.0), (0.4, 0.4)), box("box 'table'", (1.0, -0.9), (0.4, 0.4))])
    own = Solver(manipulator, map_densities(manipulator, 0.05, 10_000), clearance=BodyClearance(manipulator, walls))
    planner = TransitionPlanner(own, through(np.zeros(1), manipulator.tip([1, 1])[None, :2, 3], 0.01))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(point_by_point, "WAY_TIME", 3600.0)
        patch.setattr(Graph, "flooded", lambda graph: repeat(None))
        with pytest.raises(Ended):
            PointByPoint(planner, "minimum-switch").plan(np.array([0, 0]), after(1000))


def after(calls: int) -> Callable[[], bool]:
    """Raises Ended at the last of some calls."""
    left = iter(range(calls))

    def proceed() -> bool:
        if next(left, None) is None:
            raise Ended
        return False

    return proceed
