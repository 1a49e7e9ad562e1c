"""A moving goal, streamed by a Zenoh publisher, to the actuators and back."""

import itertools
import time
from contextlib import ExitStack

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.publisher import START, STOPPED, Publisher
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually


@pytest.fixture
def publisher(client: Observer, system: System, stack: ExitStack) -> Publisher:
    """A publisher; the arm is at the start of the stream."""
    client.move(START)
    client.wait_now("ready")
    return Publisher(stack.enter_context(system.session()), client, system.name)


def test_the_arm_follows_and_bad_setpoints_change_nothing(
    client: Observer, publisher: Publisher, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    begun, results, since = len(client.heard["state"]), len(client.heard["result"]), time.time()
    motions.clear()

    def enough(t: float) -> bool:
        motions.read()
        return t > 2.0 * SLOWNESS and len(motions.moved_at) >= 5

    publisher.stream(enough, bad=True)
    client.wait_now("ready", STOPPED)
    eventually(lambda: publisher.status()["rate"] == 0)
    eventually(lambda: client.state["measured"] == client.state["commanded"] == boards.positions().tolist())
    client.streams.append((since, time.time()))
    motions.read()
    assert np.linalg.norm(tip(boards, arm) - START) > 0.02, "the goal was followed"
    modes = [state["mode"] for state in client.heard["state"][begun:]]
    alternations = [mode for k, mode in enumerate(modes) if k == 0 or mode != modes[k - 1]]
    assert alternations[-2:] == ["executing", "ready"]
    assert all(state["goal"] is None for state in client.heard["state"][begun:])
    assert len(client.heard["result"]) == results
    told = publisher.status()
    assert told["received"] > 20
    assert told["refused"] > 5
    assert told["last_refusal"]
    assert not told["alive"]
    assert client.faults(client.wait_now("ready")) == []


def test_a_stream_that_rests_is_met(client: Observer, publisher: Publisher, boards: Simulation, arm: Arm) -> None:
    """The goal moves 0.1 away and stays there. The arm is there when switching ends."""
    goal = START[0] + 0.1, START[1]
    publisher.way = lambda t: goal
    with publisher.streaming():
        eventually(lambda: _near(client, goal))
    client.wait_now("ready")
    assert np.linalg.norm(tip(boards, arm) - goal) < 0.02


def _near(client: Observer, goal: tuple[float, float]) -> bool:
    tip = client.state["tip"]
    return tip is not None and bool(np.linalg.norm(np.subtract(tip["position"], goal)) < 0.02)


def test_a_stream_replaces_a_goal_and_a_goal_the_stream(
    client: Observer, publisher: Publisher, boards: Simulation, arm: Arm
) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))

    names = (f"b{number}" for number in itertools.count())

    def accepted() -> str:
        """Sends a goal; on a busy machine the arm follows the stream to another place before it can begin."""
        answer = client.goal(RIGHT, id=next(names))
        later = ("moved-since-planned", "arm-moved", "too-late-to-begin")
        assert answer["accepted"] or answer["reason"] in later, answer
        return answer["id"] if answer["accepted"] else ""

    def replace() -> None:
        assert client.result("a")["message"] == "replaced by a setpoint"
        assert client.result(eventually(accepted))["status"] == "succeeded"
        assert client.wait_now("ready")["goal"] is None
        assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance, "the stream is the one from before"

    publisher.throughout(replace)
    client.move(LEFT, goal="c")
    assert [len(client.results(goal)) for goal in client.accepted] == [1] * len(client.accepted)


def test_nothing_is_switched_after_a_stop(client: Observer, publisher: Publisher, motions: Motions) -> None:
    def stop() -> None:
        assert client.ask("stop")["accepted"]
        motions.clear()
        client.wait_now("stopped")
        publisher.status()
        client.reset()
        publisher.status()
        assert client.state["mode"] == "ready", "the stream is the one from before"
        assert motions.still()

    publisher.throughout(stop)
