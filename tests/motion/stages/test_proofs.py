"""Proofs that there is no way agree with trying all switches; the swept check alone decides which are clear."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages import detours
from hyperbit.controller.motion.stages.detours import Detour, Detours, NoWay
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import sphere, together
from hyperbit.controller.obstacles.sweep import Sweep
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration
from tests.obstacles.moving import Part, arm, hinge, placed, truss

RADIUS = 0.05

angles = st.floats(-1.5, 1.5)
hinges = st.builds(hinge, angles, angles, st.floats(0.1, 0.4))
trusses = st.builds(truss, st.sampled_from(["BC", "AD"]), st.just(0.2), st.just(0.2), st.just(0.26))
chains = st.lists(hinges, min_size=3, max_size=6) | st.tuples(hinges, trusses, hinges) | st.tuples(trusses, hinges)


def never() -> bool:
    """A search is not ended by the time, also on a busy machine."""
    return False


def components(manipulator: Manipulator, sweep: Sweep) -> list[list[bytes]]:
    """The lists of actuator states that clear switches of single actuators connect, by trying all of them."""
    states = [manipulator.actuator_states(c) for c in every_configuration(manipulator)]
    free = {s.tobytes(): s for s in states if sweep.first_collision(s, np.arange(0)) is None}
    left, found = dict(free), list[list[bytes]]()
    while left:
        front, own = [left.popitem()[0]], list[bytes]()
        while front:
            own.append(here := front.pop())
            for k in range(len(free[here])):
                there = free[here].copy()
                there[k] ^= 1
                if there.tobytes() in left and sweep.first_collision(free[here], np.array([k])) is None:
                    left.pop(there.tobytes())
                    front.append(there.tobytes())
        found.append(own)
    return found


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("threads", [1, 2])
def test_no_way_is_said_only_where_trying_all_switches_finds_none(seed, threads):
    """Goals of both kinds: within the start's component a transition is found, else the refusal is a proof."""
    rng = np.random.default_rng(seed)
    chain = arm([hinge(-0.8, 0.8, 0.3)] * 6)
    tips = chain.tips(every_configuration(chain))[:, :2, 3]
    discs = [sphere(f"disc {k}", tips[rng.integers(len(tips))] * rng.uniform(0.3, 0.9), 0.12) for k in range(2)]
    clearance = BodyClearance(chain, together(discs))
    solver = Solver(chain, map_densities(chain, 0.02, 10_000)).avoiding(clearance)
    known = components(chain, Sweep(clearance))
    free = [np.frombuffer(code, dtype=np.uint8) for own in known for code in own]
    for _ in range(6):
        start, end = (chain.configuration(free[rng.integers(len(free))]) for _ in range(2))
        own = next(own for own in known if chain.actuator_states(start).tobytes() in own)
        goal = solver.target(chain.tip(end)[:2, 3], 0.01)
        possible = any(goal.met(chain.configuration(np.frombuffer(code, dtype=np.uint8))) for code in own)
        planner = TransitionPlanner(solver, through(np.zeros(1), goal.goal[None, :2, 3], 0.01))
        planning = PointByPoint(planner, "minimum-switch", SearchTime(0.03, unfound=600.0), threads)
        if possible:
            planning.plan(start)
            continue
        with pytest.raises(Refusal) as caught:
            planning.plan(start)
        assert caught.value.reason is Reason.NO_WAY


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("lowest", [1, 8])
def test_a_way_through_a_narrow_gap_is_found(gap, lowest, monkeypatch):
    """The first hinge swings past a disc. The second is folded back, so that it is never nearer to the disc."""
    monkeypatch.setattr(detours, "LOWEST", lowest)
    manipulator = arm([hinge(0.0, np.pi / 2, 1.0), hinge(3.0, -3.0, 0.3)])
    away = (1.0 + RADIUS + gap) * np.sqrt(0.5)
    clearance = BodyClearance(manipulator, sphere("disc", (away, away), RADIUS))
    start, end = np.array([0, 0]), np.array([1, 0])
    assert Sweep(clearance).first_collision(manipulator.actuator_states(start), np.array([0])) is None
    found = Detours(clearance, start, end[None]).search(never)
    assert isinstance(found, Detour)
    assert found.order.tolist() == [0]


def near_misses(chain: list[Part], rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Centres of discs that the arm's tip passes at a small distance while one module moves."""
    actuators = np.cumsum([0, *(len(part.module.actuators) for part in chain)])
    centres = list[tuple[float, float]]()
    for _ in range(count):
        displacements, i = rng.integers(0, 2, actuators[-1]).astype(float), rng.integers(len(chain))
        displacements[rng.integers(actuators[i], actuators[i + 1])] = rng.random()
        lines = placed(chain, np.eye(4), displacements[None])
        below, tip = lines[i][0, 0, 0, :2], lines[-1][0, -1, 1, :2]
        outwards = (tip - below) / np.linalg.norm(tip - below)
        x, y = tip + (RADIUS + 10.0 ** rng.uniform(-6, -2)) * outwards
        centres.append((x, y))
    return centres


@settings(max_examples=15, deadline=None)
@given(chains, st.integers(0, 2**32))
def test_a_flood_lists_exactly_what_switches_reach_that_the_swept_check_proves_clear(chain, seed):
    """Among discs that the arm misses narrowly."""
    rng, manipulator = np.random.default_rng(seed), arm(chain)
    discs = [sphere(f"disc {k}", centre, RADIUS) for k, centre in enumerate(near_misses(chain, rng, 3))]
    clearance = BodyClearance(manipulator, together(discs))
    known = components(manipulator, Sweep(clearance))
    assume(known)
    configurations = [[manipulator.configuration(np.frombuffer(s, dtype=np.uint8)) for s in own] for own in known]
    start = configurations[0][0]
    if len(configurations[0]) > 1:
        found = Detours(clearance, start, configurations[0][-1][None]).search(never)
        assert isinstance(found, Detour)
    others = [each for own in configurations[1:] for each in own]
    assume(others)
    assert isinstance(Detours(clearance, start, np.array(others)).search(never), NoWay)
    listed = Detours(clearance, start, np.array(others), complete=False).search(never)
    assert isinstance(listed, NoWay)
    assert listed.reached is not None
    assert sorted(listed.reached.tolist()) == sorted(each.tolist() for each in configurations[0])
