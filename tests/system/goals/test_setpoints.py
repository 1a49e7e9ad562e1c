"""A moving goal, streamed by a Zenoh publisher, to the actuators and back."""

import itertools
import time
from contextlib import ExitStack

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.network.client import Client
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.publisher import BAD, FOLLOWING, START, STOPPED, Publisher
from tests.system.stack.system import System
from tests.waiting import PATIENCE, SLOWNESS, eventually


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
    assert client.wait_now("ready")["faults"] == []


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


def test_bad_setpoints_and_those_out_of_reach_move_nothing(
    client: Observer, publisher: Publisher, motions: Motions
) -> None:
    motions.clear()
    refused = publisher.status()["refused"]

    def told() -> bool:
        for payload in BAD:
            publisher.put(payload)
        return bool(publisher.status()["refused"] > refused)

    def said() -> bool:
        publisher.put({"position": (9.0, 9.0)})
        return any("out of reach" in state["reason"] for state in client.heard["state"])

    eventually(told)
    assert client.wait_now("ready")["mode"] == "ready"
    eventually(said)
    client.wait_now("ready")
    assert motions.still()


def test_a_stream_replaces_a_goal_and_a_goal_the_stream(
    client: Observer, publisher: Publisher, boards: Simulation, arm: Arm
) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))

    names = (f"b{number}" for number in itertools.count())

    def accepted() -> str:
        """Sends a goal; on a busy machine the arm follows the stream to another place before it can begin."""
        answer = client.goal(RIGHT, id=next(names))
        assert answer["accepted"] or answer["reason"] in ("moved-since-planned", "arm-moved"), answer
        return answer["id"] if answer["accepted"] else ""

    def replace(_: int) -> None:
        assert client.result("a")["message"] == "replaced by a setpoint"
        assert client.result(eventually(accepted))["status"] == "succeeded"
        assert client.wait_now("ready")["goal"] is None
        assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance, "the stream is the one from before"

    publisher.throughout(replace)
    client.move(LEFT, goal="c")
    assert [len(client.results(goal)) for goal in client.accepted] == [1] * len(client.accepted)


def test_cancel_holds_while_the_stream_goes_on_and_a_fresh_one_is_followed(
    client: Observer, publisher: Publisher, motions: Motions
) -> None:
    def cancel(_: int) -> None:
        assert client.ask("cancel")["message"].startswith("canceled")  # perhaps while actuators travel
        motions.clear()
        client.wait_now("ready", "following was canceled")
        received = publisher.status()["received"]
        assert publisher.status()["received"] > received, "the stream goes on"
        assert client.state["mode"] == "ready"
        assert motions.still()

    publisher.throughout(cancel)
    with publisher.streaming():
        client.wait_now("executing", FOLLOWING)
    client.wait_now("ready", "has stopped")


def test_a_setpoint_that_came_before_a_cancel_is_not_followed_after_it(
    client: Observer, system: System, motions: Motions, stack: ExitStack
) -> None:
    session = stack.enter_context(system.session())  # of both, so that they come in order
    publisher, canceling = Publisher(session, client, system.name), Client(session, system.name)
    began, before = time.time(), publisher.status()["received"]
    for k in range(1, 4):
        publisher.put({"position": LEFT if k % 2 else RIGHT})
        time.sleep(0.01 * (k - 1))  # into the search, on a fast machine
        canceling.request("cancel", timeout=PATIENCE)
        motions.clear()  # a search may still switch before the cancel, but not after it
        eventually(lambda k=k: publisher.status()["received"] >= before + k and publisher.status()["rate"] == 0)
        assert motions.still()
        client.streams.append((began, time.time()))
    client.wait_now("ready")


def test_nothing_is_switched_after_a_stop(client: Observer, publisher: Publisher, motions: Motions) -> None:
    def stop(_: int) -> None:
        assert client.ask("stop")["accepted"]
        motions.clear()
        client.wait_now("stopped")
        publisher.status()
        client.reset()
        publisher.status()
        assert client.state["mode"] == "ready", "the stream is the one from before"
        assert motions.still()

    publisher.throughout(stop)


def test_a_new_goal_ends_a_stream_that_goes_on_and_cancel_ends_the_goal(
    client: Observer, publisher: Publisher, motions: Motions
) -> None:
    def cancel(attempt: int) -> None:
        goal = f"a{attempt}"
        assert client.goal(MIDDLE, LEFT, times=[0, HOUR], id=goal)["accepted"]
        eventually(lambda: client.feedback(goal) or client.results(goal))  # the rest of the stream may replace the goal
        assert "canceled" in client.ask("cancel")["message"]
        assert client.result(goal)["status"] == "canceled"
        motions.clear()
        client.wait_now("ready", "canceled")
        publisher.status()
        assert motions.still()

    publisher.throughout(cancel)
