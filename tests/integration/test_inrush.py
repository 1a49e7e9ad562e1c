"""An arm with a bound on the inrush: what each SYNC on the bus switches."""

import time
from collections.abc import Callable

import can
import numpy as np
import pytest
from msgspec.structs import replace

from controller.config import Arm
from controller.motion import codes
from drivers import cia301
from drivers.simulation.simulation import Simulation
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.harness import Observer
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, drain, tip

INRUSH = 2
RPDO = 0x200


@pytest.fixture(scope="session")
def arm(arm: Arm) -> Arm:
    """The paper's, of which two actuators may switch at once."""
    return Arm(replace(arm.settings, inrush=INRUSH), arm.manipulator, arm.wiring)


def changes(frames: list[can.Message]) -> list[int]:
    """How many output bits change at each SYNC, of boards that all begin contracted."""
    latched, image, counts = dict[int, bytes](), dict[int, bytes](), []
    for frame in frames:
        if RPDO < frame.arbitration_id < RPDO + 0x80:
            latched[frame.arbitration_id] = bytes(frame.data)
        elif frame.arbitration_id == cia301.SYNC:
            pairs = [(data, image.get(board, bytes(len(data)))) for board, data in latched.items()]
            counts.append(sum((a ^ b).bit_count() for new, old in pairs for a, b in zip(new, old, strict=True)))
            image |= latched
    return counts


def test_never_more_at_once_on_the_bus(client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC) -> None:
    client.move(MIDDLE, RIGHT, goal="slow", times=[0.0, 2.0])
    assert client.goal(LEFT, MIDDLE, times=[0.0, HOUR], id="a")["accepted"]
    before = boards.switches().sum()
    eventually(lambda: boards.switches().sum() > before)
    assert client.goal(RIGHT, MIDDLE, times=[0.0, HOUR], id="b")["accepted"]
    before = boards.switches().sum()
    eventually(lambda: boards.switches().sum() > before)
    assert client.goal(MIDDLE, id="c")["accepted"]
    assert client.result("c")["status"] == "succeeded"
    assert [client.result(name)["status"] for name in "ab"] == ["replaced"] * 2
    client.move(RIGHT, LEFT, MIDDLE, goal="d", times=[0.0, 2.0, 4.0])
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    counts = changes(drain(listener))
    assert max(counts) <= INRUSH
    assert len(counts) > 10
    assert sum(counts) == boards.switches().sum()


def test_stages_are_told_and_end_in_time(client: Observer, boards: Simulation, listener: can.BusABC) -> None:
    points = [{"t": 0.0, "position": MIDDLE}, {"t": 2.0 * SLOWNESS, "position": RIGHT}]
    plan = client.ask("plan", waypoints=points)
    for waypoint in plan["waypoints"]:
        assert max(map(len, waypoint["stages"])) <= INRUSH
        assert sum(map(len, waypoint["stages"])) == waypoint["switches"]
        assert waypoint["excursion"] > 0
    stamp = time.time() + 1.5 * SLOWNESS
    assert client.goal(MIDDLE, RIGHT, times=[0.0, 2.0], stamp=stamp, id="a")["accepted"]
    assert client.result("a")["status"] == "succeeded"
    told: Callable[[], object] = lambda: len(client.feedback("a")) == 2  # noqa: E731
    eventually(told)
    counts = [count for count in changes(drain(listener)) if count]
    assert sum(feedback["stages"] for feedback in client.feedback("a")) == len(counts)
    assert all(feedback["excursion"] is None or feedback["excursion"] >= 0 for feedback in client.feedback("a"))


def test_a_goal_too_fast_for_the_bound_is_refused_naming_the_pair(client: Observer, boards: Simulation) -> None:
    answer = client.goal(MIDDLE, RIGHT, times=[0.0, 0.07], id="a")
    assert (answer["accepted"], answer["code"]) == (False, codes.INVALID_GOAL)
    assert answer["message"].startswith(f"waypoints[0] to waypoints[1]: {0.07 * SLOWNESS:g} s, ")
    assert "switches, at most 2 at once, need" in answer["message"]
    assert boards.switches().sum() == 0


def test_the_bound_is_described(client: Observer) -> None:
    described = client.ask("arm")
    assert (described["inrush"], described["rest_time"]) == (INRUSH, 0.0)
