"""Obstacles, sent over Zenoh or in the arm's file; the arm avoids them, or holds and says why."""

from contextlib import ExitStack
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
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.publisher import START, STOPPED, Publisher
from tests.system.stack.system import System
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.buses("virtual")

CRATE = {"disc": {"centre": list(RIGHT), "radius": 0.2}, "name": "crate"}
# Obstacles between MIDDLE and FAR, and beside.
FAR = (-0.6, 2.7)
AROUND = [
    {"disc": {"centre": [0.9, 1.4], "radius": 0.3}, "name": "pillar"},
    {"box": {"centre": [-0.9, 1.2], "size": [0.5, 0.3], "angle": 0.4}, "name": "shelf"},
]
SHAPES: list[Shape] = [Disc((0.9, 1.4), 0.3), Box(planar(-0.9, 1.2, 0.4), (0.5, 0.3))]
WALL = {"half_plane": {"point": [2.5, 0], "normal": [-1, 0]}, "name": "wall"}
TRIALS = 3  # of a stream without the post
POST = Disc((0.75, 2.2), 0.15)  # hit by many configurations that bring the tip to the line
STEP, STEPS = 0.06, 10  # of the goal that moves past the post [m]
BLOCKED = 10  # states that say so, until the goal moves on

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


def test_a_running_goal_whose_rest_would_touch_is_aborted_and_the_arm_holds(
    client: Observer, boards: Simulation
) -> None:
    client.move(LEFT)
    assert client.goal(MIDDLE, LEFT, RIGHT, times=[0, 1, HOUR], id="a")["accepted"]
    eventually(lambda: client.feedback("a") and client.feedback("a")[-1]["waypoint"] == 1)
    before = boards.switches().tolist()
    keep_out(client, CRATE)
    result = client.result("a")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert "disc 'crate'" in result["message"]
    assert "disc 'crate'" in client.wait_now("ready")["reason"]
    assert boards.switches().tolist() == before
    client.move(MIDDLE, goal="b")
    keep_out(client)


def test_regions_that_come_during_motion_are_kept_out_of_from_then_on(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    """The goal continues stage by stage, or is aborted if its remaining stages would collide."""
    client.move(MIDDLE)
    points = [(MIDDLE, LEFT)[k % 2] for k in range(20)]
    assert client.goal(*points, times=[0.1 * k for k in range(20)], id="a")["accepted"]
    eventually(lambda: client.feedback("a"))
    keep_out(client, *AROUND)
    motions.read()
    rows = [motions.outputs]
    motions.clear()
    result = client.result("a")
    motions.read()
    rows += motions.rows[1:]  # the first may have been begun before
    assert result["status"] in ("succeeded", "aborted"), result
    assert least_room(arm, rows[1:], SHAPES) > 0
    keep_out(client)


def test_an_arm_that_stands_in_a_region_says_so_and_malformed_regions_change_nothing(client: Observer) -> None:
    client.move(MIDDLE)
    assert "where the arm stands" in keep_out(client, {"disc": {"centre": list(MIDDLE), "radius": 0.1}, "name": "hand"})
    eventually(lambda: "in-obstacle" in client.codes)
    for payload in ({}, {"regions": [{}]}, {"regions": [CRATE, CRATE]}, {"regions": [], "more": 1}):
        assert client.client.request("obstacles", payload)["accepted"] is False
    refused = client.goal(LEFT)
    assert (refused["accepted"], "disc 'hand'" in refused["message"]) == (False, True)
    keep_out(client)
    eventually(lambda: not client.codes)
    client.move(LEFT, goal="b")


@pytest.mark.arm(obstacles=[WALL])
@pytest.mark.fresh
def test_a_new_planner_knows_the_regions_of_the_file_only(system: System) -> None:
    system.start()
    for _ in range(2):
        with system.client() as client:
            client.wait_for("ready")
            assert client.goal(RIGHT)["accepted"] is False
            assert keep_out(client) == "1 obstacle, 0 of them sent"
            assert keep_out(client, *AROUND) == "3 obstacles, 2 of them sent"
        system.end_planner()
        system.start_planner()


def test_setpoints_past_a_region_are_followed_clear_of_it(
    client: Observer, system: System, arm: Arm, motions: Motions, stack: ExitStack
) -> None:
    def streamed(goal: str) -> list[np.ndarray]:
        """The switches from the start of a stream to its end."""
        client.move(START, goal=goal)
        motions.read()
        first, line = [motions.outputs], Line(client)
        motions.clear()

        def ended() -> bool:
            motions.read()  # all the time, because the bus keeps only so many frames
            return line.ended

        with Publisher(stack.enter_context(system.session()), client, system.name, line).streaming():
            eventually(ended, patience=4 * PATIENCE)
        client.wait_now("ready", STOPPED)
        motions.read()
        return first + motions.rows

    keep_out(client, {"disc": {"centre": list(POST.centre), "radius": POST.radius}, "name": "post"})
    rows = streamed("among")
    assert len(rows) > 2
    assert least_room(arm, rows, [POST]) > 0
    keep_out(client)
    alone = (least_room(arm, streamed(f"alone{k}"), [POST]) for k in range(TRIALS))
    assert any(distance < 0 for distance in alone), "the region was in the way"


class Line:
    """A goal that moves 0.6 to the right, however slow this machine is.

    It makes a step whenever the tip has arrived, or the daemon says again and again that the post blocks the way there.
    The first of these states may belong to the step before.

    Attributes:
        ended: the goal is at the end of the line, and the tip has arrived or is blocked.
    """

    def __init__(self, client: Observer) -> None:
        self._client, self._step, self._since, self.ended = client, 0, 0, False

    def __call__(self, t: float) -> tuple[float, float]:
        goal = START[0] + STEP * self._step, START[1]
        states = self._client.heard["state"]
        latest = states[self._since :][-BLOCKED:]
        blocked = len(latest) == BLOCKED and all("disc 'post'" in state["reason"] for state in latest)
        if blocked or np.linalg.norm(np.subtract(self._client.state["tip"]["position"], goal)) < 0.05:
            self._since = len(states)
            self._step, self.ended = min(self._step + 1, STEPS), self._step == STEPS
        return goal
