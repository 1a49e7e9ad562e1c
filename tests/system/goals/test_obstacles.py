"""Obstacles that clients send: the arm on its bus is clear of them."""

from itertools import pairwise

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.obstacles.dense import Box, Disc, Shape
from tests.obstacles.moving import motion, room, truss
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, tip

pytestmark = pytest.mark.buses("virtual")

CRATE = {"disc": {"centre": list(RIGHT), "radius": 0.2}, "name": "crate"}
# Obstacles between MIDDLE and FAR, and beside.
FAR = (-0.6, 2.7)
AROUND = [
    {"disc": {"centre": [0.9, 1.4], "radius": 0.3}, "name": "pillar"},
    {"box": {"centre": [-0.9, 1.2], "size": [0.5, 0.3], "angle": 0.4}, "name": "shelf"},
]
SHAPES: list[Shape] = [Disc((0.9, 1.4), 0.3), Box(planar(-0.9, 1.2, 0.4), (0.5, 0.3))]

PARTS = [truss("BC", 0.2, 0.2, 0.25), truss("AD", 0.2, 0.2, 0.25)] * 8  # of the paper's arm
MOTIONS, SAMPLES, CORNERS = 3, 10, 30  # of each transition


def keep_out(client: Observer, *regions: object) -> str:
    answer = client.ask("obstacles", regions=list(regions))
    assert answer["accepted"], answer
    return str(answer["message"])


@pytest.fixture
def client(client: Observer) -> Observer:
    """The client of an arm in its start configuration, because configurations depend on the earlier ones."""
    assert client.send("goal", waypoints=[{"configuration": "0" * 16}], id="home")["accepted"]
    result = client.result("home")
    assert result["status"] == "succeeded", result
    return client


def least_room(arm: Arm, rows: list[np.ndarray], shapes: list[Shape]) -> float:
    """The smallest distance of the arm, with actuators between the rows in any order."""
    chance, away = np.random.default_rng(0), np.inf
    for before, after in pairwise(rows):
        corners = np.where(chance.random((CORNERS, len(before))) < 0.5, before, after)
        displacements = [motion(chance, before, after, SAMPLES) for _ in range(MOTIONS)]
        every = np.concatenate([[before, after], corners, *displacements]).astype(float)
        away = min(away, room(PARTS, arm.manipulator.base, shapes, every, 40, pairs=False)[0])
    return away


def test_goals_are_planned_around_regions_that_are_sent_until_they_are_gone(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.move(MIDDLE)
    before = boards.switches().tolist()
    assert keep_out(client, CRATE) == "1 obstacle, 1 of them sent"
    refused = client.goal(RIGHT)
    assert (refused["accepted"], refused["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    assert boards.switches().tolist() == before
    assert keep_out(client, *AROUND) == "2 obstacles, 2 of them sent"
    motions.read()
    rows = [motions.outputs]
    motions.clear()
    for number, goal in enumerate((FAR, LEFT, RIGHT, MIDDLE)):
        if client.goal(goal, id=f"b{number}")["accepted"]:
            assert client.result(f"b{number}")["status"] == "succeeded"
            assert np.linalg.norm(tip(boards, arm) - goal) <= arm.tolerance
    assert len(client.accepted) >= 4
    motions.read()
    rows += motions.rows
    assert len(rows) > 3
    assert least_room(arm, rows, SHAPES) > 0
    assert keep_out(client) == "0 obstacles, 0 of them sent"
    client.move(RIGHT, goal="c")
