"""Setpoints that move past a region: no configuration that the arm could be in touches it, by the frames on the bus."""

from itertools import pairwise

import can
import numpy as np
import pytest

from controller.config import Arm
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing, Wiring
from tests.daemon.waiting import SLOWNESS
from tests.integration.conftest import Bench, enduring
from tests.integration.motions import Motions
from tests.integration.test_obstacles import keep_out
from tests.integration.test_setpoints import START, Publisher
from tests.obstacles.dense import Disc
from tests.obstacles.moving import motion, room, truss

PARTS = [truss("BC", 0.2, 0.2, 0.25), truss("AD", 0.2, 0.2, 0.25)] * 8  # of the paper's arm
POST = Disc((0.75, 2.2), 0.15)  # where many configurations have modules that bring the tip to the line
SPEED, SECONDS = 0.1 / SLOWNESS, 6.0 * SLOWNESS
END, REST = (START[0] + SPEED * SECONDS, START[1]), 1.0 * SLOWNESS
MOTIONS, SAMPLES, CORNERS = 3, 10, 30  # of each transition


def line(t: float) -> tuple[float, float]:
    return START[0] + SPEED * min(t, SECONDS), START[1]


def least_room(arm: Arm, rows: list[np.ndarray]) -> float:
    """How near the arm may have come while its actuators went from each of the rows to the next as they liked."""
    chance, away = np.random.default_rng(0), np.inf
    for before, after in pairwise(rows):
        corners = np.where(chance.random((CORNERS, len(before))) < 0.5, before, after)
        strokes = [motion(chance, before, after, SAMPLES) for _ in range(MOTIONS)]
        every = np.concatenate([[before, after], corners, *strokes]).astype(float)
        away = min(away, room(PARTS, arm.manipulator.base, [POST], every, 40, pairs=False)[0])
    return away


@pytest.fixture
def traced(wiring: Wiring, listener: can.BusABC, bench: Bench, boards: Simulation, timing: Timing) -> Motions:
    """What a daemon that is patient with its boards switches."""
    traced = Motions(wiring, listener)
    bench.run(enduring(timing))
    return traced


def test_setpoints_past_a_region_are_followed_clear_of_it(traced: Motions, bench: Bench, arm: Arm) -> None:
    client = bench.observer()
    client.wait_for("ready")

    def streamed(goal: str) -> tuple[list[np.ndarray], list[float]]:
        """What was switched from where a stream begins to its end, and when."""
        client.move(START, goal=goal)
        traced.read()
        first = len(traced.rows)
        publisher = Publisher(bench.session(), arm, line)
        publisher.stream(SECONDS + REST)
        client.wait_now("ready", "the stream of setpoints has stopped")
        traced.read()
        return traced.rows[first - 1 :], traced.moved_at[first - 1 :]

    keep_out(client, {"disc": {"centre": list(POST.centre), "radius": POST.radius}, "name": "post"})
    rows, times = streamed("among")
    assert len(rows) > 10
    assert min(np.diff(times)) > arm.settings.travel_time - 0.02 * SLOWNESS, "each is settled before the next"
    assert least_room(arm, rows) > 0
    reached = arm.manipulator.tip(arm.manipulator.configuration(rows[-1]))[:2, 3]
    assert np.linalg.norm(reached - END) < 0.05, "the region was passed"
    keep_out(client)
    rows, _ = streamed("alone")
    assert least_room(arm, rows) < 0, "the region was in the way"
