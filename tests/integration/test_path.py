"""A goal that follows straight lines: what the bus switches, and where the tip physically is meanwhile."""

import time
from itertools import pairwise

import can
import numpy as np
import pytest

from controller.config import Arm
from controller.daemon.client import Message
from controller.daemon.service import Daemon
from controller.motion import codes
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing
from tests.daemon.waiting import SLOWNESS
from tests.integration.conftest import Bench, enduring
from tests.integration.harness import Observer
from tests.integration.test_goals import LEFT, MIDDLE, drain, tip
from tests.integration.test_inrush import changes

PATH = 0.03
CORNER = (0.55, 2.8)
POINTS, TIMES = (MIDDLE, CORNER, LEFT), [0.0, 2.0, 5.0]  # on a slow machine these are slow
LAG = 1.0  # [s] by which this computer may be late


@pytest.fixture
def daemon(bench: Bench, boards: Simulation, timing: Timing) -> Daemon:
    """A daemon that is patient with boards which a loaded machine keeps waiting."""
    return bench.run(enduring(timing))


def wanted(t: float) -> np.ndarray:
    return np.array([np.interp(t / SLOWNESS, TIMES, column) for column in np.array(POINTS).T])


def followed(client: Observer, boards: Simulation, arm: Arm, stamp: float) -> list[tuple[float, float]]:
    """Times, and distances of the settled tip from the moving point, until the goal has its result."""
    seen = []
    while not client.results("a"):
        t, positions = time.time() - stamp, boards.positions()
        if 0 <= t <= TIMES[-1] * SLOWNESS and np.isin(positions, (0, 1)).all():
            at = arm.manipulator.tip(arm.manipulator.configuration(positions))[:2, 3]
            seen.append((t, float(np.linalg.norm(at - wanted(t)))))
        time.sleep(0.002 * SLOWNESS)
    return seen


def test_the_tip_stays_by_the_moving_point_and_little_switches(
    client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC
) -> None:
    stamp = time.time() + 1.5 * SLOWNESS
    answer = client.goal(*POINTS, times=TIMES, stamp=stamp, id="a", path_tolerance=PATH)
    assert answer["accepted"], answer
    seen = followed(client, boards, arm, stamp)
    assert client.result("a")["status"] == "succeeded"
    assert np.linalg.norm(tip(boards, arm) - LEFT) <= arm.tolerance
    fastest = max(np.linalg.norm(np.diff(POINTS, axis=0), axis=1) / np.diff(TIMES))
    assert len(seen) > 100
    assert max(away for _, away in seen) <= PATH + LAG * fastest
    assert np.mean([away <= PATH for _, away in seen]) > 0.8
    told = [feedback["waypoint"] for feedback in client.feedback("a")]
    assert told[-1] == 2, "a loaded machine may miss one before"
    assert told == sorted(set(told))
    assert sum(feedback["stages"] for feedback in client.feedback("a")) <= client.result("a")["switches"]
    counts = changes(drain(listener))
    assert sum(counts) == boards.switches().sum() == client.result("a")["switches"]
    assert counts.count(0) <= len(POINTS), "what is held is not commanded again"
    assert len(counts) > len(POINTS)


def test_a_plan_tells_all_points_and_the_lines_are_kept_by_each(client: Observer, boards: Simulation) -> None:
    points = [{"t": t * SLOWNESS, "position": p} for t, p in zip(TIMES, POINTS, strict=True)]
    answer: Message = client.ask("plan", waypoints=points, path_tolerance=PATH)
    assert answer["accepted"], answer
    told = answer["waypoints"]
    assert [w["t"] for w in told if not w["between"]] == [t * SLOWNESS for t in TIMES]
    for own, following in pairwise(told):
        for t in np.linspace(own["t"], following["t"], 9):
            assert np.linalg.norm(wanted(t) - own["position"]) <= PATH + 1e-9
    assert sum(w["switches"] > 0 for w in told) < len(told) / 2
    assert boards.switches().sum() == 0


def test_what_cannot_be_followed_is_refused_in_words(client: Observer, boards: Simulation) -> None:
    fast = client.goal(MIDDLE, LEFT, times=[0.0, 0.3], id="a", path_tolerance=0.01)
    assert (fast["accepted"], fast["code"]) == (False, codes.INVALID_GOAL)
    assert fast["message"].startswith(
        f"waypoints[0] to waypoints[1]: {0.3 * SLOWNESS:g} s for a line of 0.15 within path_tolerance"
    )
    ends = (-2.6, 1.5), (2.6, 1.5)  # the way goes through where the arm is too long to be
    far = client.goal(*ends, times=[0.0, 60.0], id="b", path_tolerance=0.05)
    assert (far["accepted"], far["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    assert far["message"].startswith("waypoints[0] to waypoints[1]: (")
    wrong = client.ask("goal", waypoints=[{"position": [0.4, 2.9]}], path_tolerance=0)
    assert (wrong["accepted"], wrong["code"]) == (False, codes.INVALID_GOAL)
    assert wrong["message"].startswith("path_tolerance: ")
    assert boards.switches().sum() == 0
