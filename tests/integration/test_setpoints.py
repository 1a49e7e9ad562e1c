"""A moving goal, streamed by a Zenoh publisher, to the actuators and back."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import can
import numpy as np
import pytest
import zenoh

from controller.config import Arm
from controller.daemon.service import Daemon
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.conftest import Bench, enduring
from tests.integration.harness import Observer
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, drain, syncs, tip

START = (0.5, 2.8)
RATE = 50.0 / SLOWNESS  # [Hz]
BAD = [b"{", b'{"position": [NaN, 1]}', b'{"position": [1, 2], "stamp": 1}', b'{"position": [1, 2, 3]}', b" " * 20_000]


def circle(t: float) -> tuple[float, float]:
    """A goal that goes round at 0.1 m/s, on a slow machine slower, from START on."""
    turn = 0.5 * t / SLOWNESS
    return START[0] + 0.2 * math.sin(turn), START[1] + 0.2 * (1 - math.cos(turn))


class Publisher:
    """Streams setpoints of a goal that moves with the clock.

    Attributes:
        position: where the goal was last.
    """

    def __init__(self, session: zenoh.Session, arm: Arm, way: Callable[[float], tuple[float, float]] = circle) -> None:
        self._session, self._key, self._way = session, f"hyperbit/{arm.settings.name}/setpoint", way
        self.position = START

    def put(self, payload: dict[str, Any] | bytes) -> None:
        self._session.put(self._key, payload if isinstance(payload, bytes) else json.dumps(payload))

    def cancel(self) -> None:
        """Cancels, and waits for the answer."""
        list(self._session.get(self._key.replace("/setpoint", "/cancel")))

    def stream(self, seconds: float, ended: Callable[[], bool] = lambda: False, bad: bool = False) -> None:
        """Streams for so long, with something bad after every setpoint if told to."""
        began = time.monotonic()
        for k in range(int(seconds * RATE)):
            if ended():
                return
            t = time.monotonic() - began
            self.position = self._way(t)
            self.put({"position": self.position, "stamp": time.time()})
            time.sleep(max(k / RATE + 0.5 / RATE - t, 0))
            if bad:
                self.put(BAD[k % len(BAD)])
            time.sleep(max(began + (k + 1) / RATE - time.monotonic(), 0))

    @contextmanager
    def streaming(self) -> Iterator[None]:
        """Streams while the context lasts."""
        over = threading.Event()
        thread = threading.Thread(target=self.stream, args=(HOUR, over.is_set))
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


@pytest.fixture
def daemon(bench: Bench, boards: Simulation, timing: Timing) -> Daemon:
    """A daemon that is patient with boards which a loaded machine keeps waiting."""
    return bench.run(enduring(timing))


@pytest.fixture
def publisher(client: Observer, bench: Bench, arm: Arm) -> Publisher:
    """A publisher; the arm is where it begins."""
    client.move(START)
    client.wait_now("ready")
    return Publisher(bench.session(), arm)


def setpoint(client: Observer) -> dict[str, Any]:
    """What is told next of the stream."""
    told = len(client.heard["diagnostics"])
    return eventually(lambda: client.heard["diagnostics"][told:])[0]["setpoint"]


def test_the_arm_follows_and_bad_setpoints_change_nothing(
    client: Observer, publisher: Publisher, boards: Simulation, arm: Arm, listener: can.BusABC
) -> None:
    begun, results = len(client.heard["state"]), len(client.heard["result"])
    drain(listener)
    switched_before = boards.switches().sum()
    publisher.stream(2.0 * SLOWNESS, bad=True)
    goal = publisher.position
    client.wait_now("ready", "the stream of setpoints has stopped")
    transitions = syncs(drain(listener))
    assert len(transitions) >= 5
    assert all(b - a > arm.settings.travel_time - 0.02 * SLOWNESS for a, b in pairwise(transitions))
    assert np.linalg.norm(tip(boards, arm) - goal) < 0.05, "0.2 m were gone"
    modes = [state["mode"] for state in client.heard["state"][begun:]]
    alternations = [mode for k, mode in enumerate(modes) if k == 0 or mode != modes[k - 1]]
    assert alternations[-2:] == ["executing", "ready"]
    assert all(state["goal"] is None for state in client.heard["state"][begun:])
    assert len(client.heard["result"]) == results
    told = setpoint(client)
    assert told["received"] > 20
    assert told["refused"] > 5
    assert told["last_refusal"]
    assert not told["alive"]
    state = client.wait_now("ready")
    assert state["measured"] == state["commanded"] == boards.positions().astype(int).tolist()
    assert eventually(lambda: client.heard["diagnostics"][-1]["switches"] == boards.switches().sum())
    assert boards.switches().sum() > switched_before


def test_bad_setpoints_alone_move_nothing(client: Observer, publisher: Publisher, listener: can.BusABC) -> None:
    drain(listener)
    for k in range(25):
        publisher.put(BAD[k % len(BAD)])
        time.sleep(1 / RATE)
    eventually(lambda: setpoint(client)["refused"] > 0)
    assert client.heard["state"][-1]["mode"] == "ready"
    assert syncs(drain(listener)) == []


def test_out_of_reach_is_said_and_moves_nothing(client: Observer, publisher: Publisher, listener: can.BusABC) -> None:
    drain(listener)

    def said() -> bool:
        publisher.put({"position": (9.0, 9.0)})
        return any("out of reach" in state["reason"] for state in client.heard["state"])

    eventually(said)
    client.wait_now("ready")
    assert syncs(drain(listener)) == []


def test_a_stream_replaces_a_goal_and_a_goal_the_stream(
    client: Observer, publisher: Publisher, boards: Simulation, arm: Arm
) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    with publisher.streaming():
        assert client.result("a")["message"] == "replaced by a setpoint"
        client.wait_now("executing", "following a setpoint")
        assert client.goal(RIGHT, id="b")["accepted"]
        assert client.result("b")["status"] == "succeeded"
        client.wait_now("ready", "goal b was reached")
        assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance
    client.move(LEFT, goal="c")
    assert [len(client.results(goal)) for goal in "abc"] == [1, 1, 1]


def test_cancel_holds_while_the_stream_goes_on_and_a_fresh_one_is_followed(
    client: Observer, publisher: Publisher, listener: can.BusABC
) -> None:
    with publisher.streaming():
        client.wait_now("executing", "following a setpoint")
        assert client.ask("cancel")["message"] == "canceled"
        drain(listener)
        client.wait_now("ready", "following was canceled")
        received = setpoint(client)["received"]
        assert setpoint(client)["received"] > received, "the stream goes on"
        assert client.heard["state"][-1]["mode"] == "ready"
        assert syncs(drain(listener)) == []
    eventually(lambda: setpoint(client)["rate"] == 0)
    with publisher.streaming():
        client.wait_now("executing", "following a setpoint")
    client.wait_now("ready", "has stopped")


def test_a_setpoint_that_came_before_a_cancel_is_not_followed_after_it(
    client: Observer, publisher: Publisher, listener: can.BusABC
) -> None:
    for k in range(1, 6):
        publisher.put({"position": LEFT if k % 2 else RIGHT})
        publisher.cancel()
        drain(listener)  # a search may be quick enough to switch before the cancel, but not after it
        eventually(lambda k=k: setpoint(client)["received"] >= k and setpoint(client)["rate"] == 0)
        assert syncs(drain(listener)) == []
    assert all(state["mode"] == "ready" for state in client.heard["state"][-20:])


def test_nothing_is_switched_after_a_stop(client: Observer, publisher: Publisher, listener: can.BusABC) -> None:
    with publisher.streaming():
        client.wait_now("executing", "following a setpoint")
        assert client.ask("stop")["accepted"]
        drain(listener)
        client.wait_now("stopped")
        setpoint(client)
        assert client.ask("reset")["accepted"]
        client.wait_now("ready")
        setpoint(client)
        assert client.heard["state"][-1]["mode"] == "ready", "the stream is the one from before"
        assert syncs(drain(listener)) == []
