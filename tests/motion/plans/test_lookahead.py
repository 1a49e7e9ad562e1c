"""Look-ahead: fewer switches over a whole trajectory, with every waypoint reached."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.motion.plans import lookahead
from hyperbit.controller.motion.plans.lookahead import LookAhead
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.search.solver import Solver
from tests.obstacles.dense import Disc, nearest, obstacles_of

TOLERANCE = 0.002


@pytest.fixture(scope="module")
def solver(arm, densities):
    return Solver(arm.manipulator, densities)


def curve(count: int, radius: float = 0.3) -> np.ndarray:
    turns = np.linspace(0.0, 2 * np.pi, count)
    return np.column_stack((0.2 + radius * np.cos(turns), 2.6 + radius / 2 * np.sin(turns)))


def cheapest_each_time(solver, start, goals) -> int:
    total, previous = 0, start
    for goal in goals:
        found = solver.solve(solver.target(goal, TOLERANCE), previous, timeout=10.0)
        total, previous = total + found.switches, found.configuration
    return total


def switches(solver, start, configurations) -> int:
    pairs = zip([start, *configurations], configurations, strict=False)
    return sum(solver.manipulator.switches(a, b) for a, b in pairs)


def followed(solver, start, goals, decide=lambda ahead, k: None):
    ahead = LookAhead(TrajectoryPoints(solver, through(np.arange(len(goals)), np.array(goals), TOLERANCE)), start)
    for k in range(1, len(goals) + 1):
        ahead.extend()
        decide(ahead, k)
    return ahead.decide(len(goals))


def test_a_curve_of_100_waypoints_takes_at_least_15_percent_less(solver):
    goals = curve(100)
    start = solver.solve(solver.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64), timeout=10.0).configuration
    chosen = followed(solver, start, goals[1:])
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals[1:], axis=1).max() <= TOLERANCE
    assert switches(solver, start, chosen) <= 0.85 * cheapest_each_time(solver, start, goals[1:])


def test_what_is_decided_stays_decided(solver):
    goals = curve(20)
    start = solver.solve(solver.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64)).configuration
    seen: list[list[bytes]] = []

    def decide(ahead, k):
        ahead.decide(max(k - 3, 0))  # as if the arm follows closely
        seen.append([c.tobytes() for c in ahead.decided()])

    chosen = [c.tobytes() for c in followed(solver, start, goals[1:], decide)]
    assert len(chosen) == 19
    for k, decided in enumerate(seen, 1):
        assert len(decided) >= max(k - 3, 0)
        assert chosen[: len(decided)] == decided


def test_a_waypoint_too_far_for_small_tables_is_met_all_the_same(solver):
    start = np.zeros(16, dtype=np.int64)
    goals = [(3.0, 0.7), (-1.5, 2.0), (-1.45, 2.0)]
    chosen = followed(solver, start, goals)
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals, axis=1).max() <= TOLERANCE


def test_every_configuration_ahead_keeps_clear(solver):
    goals, parts = curve(20), [Disc((-0.35, 1.5), 0.15)]
    among = solver.avoiding(BodyClearance(solver.manipulator, obstacles_of(parts), 0.02))
    start = among.solve(among.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64)).configuration
    chosen = followed(among, start, goals[1:])
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals[1:], axis=1).max() <= TOLERANCE
    assert min(nearest(solver.manipulator.body(c), parts) for c in [start, *chosen]) > 0.02
    plain = followed(solver, np.zeros(16, dtype=np.int64), goals)
    assert min(nearest(solver.manipulator.body(c), parts) for c in plain) < 0.02


def test_weights_decide_what_is_cheap(arm, densities, monkeypatch):
    monkeypatch.setattr(lookahead, "WIDTH", 8)
    weights = np.where(np.arange(48) < 24, 5.0, 1.0)
    goals = curve(12)
    dear = {}
    for name, solver in (
        ("plain", Solver(arm.manipulator, densities)),
        ("weighted", Solver(arm.manipulator, densities, weights)),
    ):
        start = solver.solve(
            solver.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64), "ipop-previous"
        ).configuration
        states = [arm.manipulator.actuator_states(c) for c in (start, *followed(solver, start, goals[1:]))]
        dear[name] = float((np.diff(np.array(states, dtype=int), axis=0) != 0)[:, :24].sum())
    assert dear["weighted"] < dear["plain"]


def test_orientations_are_kept_along_the_way(solver):
    """At every third waypoint; the configuration stays as long as it serves."""
    m, rng = solver.manipulator, np.random.default_rng(3)
    path = [rng.integers(0, 8, 16)]
    for _ in range(11):
        path.append(np.where(rng.random(16) < 0.15, rng.integers(0, 8, 16), path[-1]))
    tips = m.tips(path)
    turns = np.where(np.arange(12) % 3 == 0, 0.03, np.inf)
    trajectory = through(np.arange(12.0), tips[:, :2, 3], 0.005, None, tips[:, :3, :3], turns)
    ahead = LookAhead(TrajectoryPoints(solver, trajectory), path[0], 1)
    for _ in range(11):
        ahead.extend()
    for k, configuration in enumerate(ahead.decide(11), 1):
        tip = m.tip(configuration)
        assert np.linalg.norm(tip[:2, 3] - tips[k, :2, 3]) <= 0.005
        assert angle_between(tip, tips[k]) <= turns[k]
