"""A goal along straight lines: the tip after each SYNC on the bus."""

from itertools import pairwise

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, tip
from tests.waiting import SLOWNESS

pytestmark = pytest.mark.buses("virtual")

PATH = 0.03
CORNER = (0.55, 2.8)
POINTS, TIMES = (MIDDLE, CORNER, LEFT), [0.0, 2.0, 5.0]  # slower on a slow machine


def wanted(t: float) -> np.ndarray:
    return np.array([np.interp(t / SLOWNESS, TIMES, column) for column in np.array(POINTS).T])


def test_the_tip_stays_by_the_lines_and_little_switches(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.move(MIDDLE)
    motions.clear()
    before = boards.switches().sum()
    answer = client.goal(*POINTS, times=TIMES, id="a", path_tolerance=PATH)
    assert answer["accepted"], answer
    result = client.result("a")
    assert result["status"] == "succeeded", result
    assert np.linalg.norm(tip(boards, arm) - LEFT) <= arm.tolerance
    motions.read()
    manipulator = arm.manipulator
    line = np.array([wanted(t) for t in np.linspace(0.0, TIMES[-1] * SLOWNESS, 500)])
    for row in motions.rows:
        at = manipulator.tip(manipulator.configuration(row))[:2, 3]
        assert np.linalg.norm(line - at, axis=1).min() <= PATH + 1e-3
    assert len(motions.rows) > 2
    told = [feedback["waypoint"] for feedback in client.last_feedback("a", 2)]  # a busy machine may leave out others
    assert told[-1] == 2
    assert told == sorted(set(told))
    switches = client.result("a")["switches"]
    assert sum(feedback["stages"] for feedback in client.feedback("a")) <= switches
    assert boards.switches().sum() - before == switches
    assert len(motions.syncs) - len(motions.moved_at) <= len(POINTS), "what is held is not commanded again"


def test_a_plan_tells_all_points_and_the_lines_are_kept_by_each(client: Observer, motions: Motions) -> None:
    points = [{"t": t * SLOWNESS, "position": p} for t, p in zip(TIMES, POINTS, strict=True)]
    answer = client.ask("plan", waypoints=points, path_tolerance=PATH)
    assert answer["accepted"], answer
    told = answer["waypoints"]
    assert [w["t"] for w in told if not w["between"]] == [t * SLOWNESS for t in TIMES]
    for own, following in pairwise(told):
        for t in np.linspace(own["t"], following["t"], 9):
            assert np.linalg.norm(wanted(t) - own["position"]) <= PATH + 1e-9
    assert sum(w["switches"] > 0 for w in told) < len(told) / 2
    assert motions.still()


def test_what_cannot_be_followed_is_refused_in_words(client: Observer, motions: Motions) -> None:
    fast = client.goal(MIDDLE, LEFT, times=[0.0, 0.3], id="a", path_tolerance=0.01)
    assert (fast["accepted"], fast["code"]) == (False, codes.INVALID_GOAL)
    assert fast["message"].startswith(
        f"waypoints[0] to waypoints[1]: {0.3 * SLOWNESS:g} s for a line of 0.15 within path_tolerance"
    )
    ends = (-2.6, 1.5), (2.6, 1.5)  # the straight line between them is out of reach
    far = client.goal(*ends, times=[0.0, 60.0], id="b", path_tolerance=0.05)
    assert (far["accepted"], far["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    assert far["message"].startswith("waypoints[0] to waypoints[1]: (")
    wrong = client.ask("goal", waypoints=[{"position": [0.4, 2.9]}], path_tolerance=0)
    assert (wrong["accepted"], wrong["code"]) == (False, codes.INVALID_GOAL)
    assert wrong["message"].startswith("path_tolerance: ")
    assert motions.still()
