"""An arm with an inrush bound: the switches of each SYNC on the bus."""

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.waiting import SLOWNESS, eventually

INRUSH = 2

pytestmark = pytest.mark.arm(inrush=INRUSH)


@pytest.fixture
def counts(motions: Motions) -> list[int]:
    counts, before = list[int](), [motions.outputs]
    take = motions.sync

    def sync(stamp: float) -> None:
        take(stamp)
        counts.append(int((motions.outputs != before[0]).sum()))
        before[0] = motions.outputs

    motions.sync = sync  # type: ignore[method-assign]
    return counts


def test_never_more_at_once_on_the_bus(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions, counts: list[int]
) -> None:
    """Takes 7 s, as its goals have waypoints at 2 s and 4 s."""
    client.move(MIDDLE, RIGHT, goal="slow", times=[0.0, 2.0])
    before = boards.switches().sum()
    assert client.goal(LEFT, MIDDLE, times=[0.0, HOUR], id="a")["accepted"]
    eventually(lambda: boards.switches().sum() > before)
    before = boards.switches().sum()
    assert client.goal(RIGHT, MIDDLE, times=[0.0, HOUR], id="b")["accepted"]
    client.result("a")
    eventually(lambda: boards.switches().sum() > before)
    assert client.goal(MIDDLE, id="c")["accepted"]
    assert client.result("c")["status"] == "succeeded"
    assert [client.result(name)["status"] for name in "ab"] == ["replaced"] * 2
    client.move(RIGHT, LEFT, MIDDLE, goal="d", times=[0.0, 2.0, 4.0])
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    motions.read()
    assert max(counts) <= INRUSH
    assert len(counts) > 10
    assert sum(counts) == motions.switched.sum()


def test_stages_are_published_as_they_are_on_the_bus(client: Observer, motions: Motions, counts: list[int]) -> None:
    client.move(LEFT)
    motions.read()
    counts.clear()
    points = [{"t": 0.0, "position": MIDDLE}, {"t": 2.0 * SLOWNESS, "position": RIGHT}]
    plan = client.ask("plan", waypoints=points)
    for waypoint in plan["waypoints"]:
        assert sum(map(len, waypoint["stages"])) == waypoint["switches"]
        assert max(map(len, waypoint["stages"])) <= INRUSH
    assert client.goal(MIDDLE, RIGHT, times=[0.0, 2.0], id="a")["accepted"]
    assert client.result("a")["status"] == "succeeded"
    motions.read()
    feedback = client.last_feedback("a", 1)
    assert len(feedback) == 2
    assert sum(it["stages"] for it in feedback) == len([count for count in counts if count])
    assert all(it["excursion"] is None or it["excursion"] >= 0 for it in feedback)


@pytest.mark.buses("virtual")
def test_a_goal_too_fast_for_the_bound_is_refused_naming_the_pair(client: Observer) -> None:
    client.move(LEFT)
    answer = client.goal(MIDDLE, RIGHT, times=[0.0, 0.07], id="a")
    assert (answer["accepted"], answer["code"]) == (False, codes.INVALID_GOAL)
    assert answer["message"].startswith(f"waypoints[0] to waypoints[1]: {0.07 * SLOWNESS:g} s, ")
    assert "switches, at most 2 at once, need" in answer["message"]


@pytest.mark.buses("virtual")
def test_the_bound_is_described(client: Observer) -> None:
    described = client.ask("arm")
    assert (described["inrush"], described["rest_time"]) == (INRUSH, 0.0)
