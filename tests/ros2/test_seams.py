"""What happens between two steps of the bridge: goals that come while it begins or ends, and a daemon that goes."""

import json
import random
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.ros2 import goals
from hyperbit.controller.ros2.goal_book import BookedGoal, GoalBook
from hyperbit.controller.ros2.goals import LOST
from hyperbit.controller.ros2.messages import STALE
from hyperbit.controller.ros2.wire.cdr import deserialize, serialize
from tests.ros2.client import ABORTED, SUCCEEDED
from tests.ros2.fuzz.inputs import TIP, Input, Inputs, payloads
from tests.ros2.fuzz.stand_ins import Pool
from tests.ros2.fuzz.world import World
from tests.ros2.samples import ACTION, TYPES, pose_stamped, state
from tests.ros2.test_bad_input import ATTACHMENT, ID, SEND_GOAL, UUID, describe_again, get_result, send_goal

BOOKED = BookedGoal(UUID.hex(), "tip", ("tip_x", "tip_y"), 1)


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    world = World(Inputs(random.Random(0)), tmp_path)
    monkeypatch.setattr(world.daemon, "request", lambda *_: {"accepted": True})
    return world


def said(world: World, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    sentences: list[str] = []

    def receive(data: bytes) -> None:
        sentences.append(deserialize(data, "rcl_interfaces/msg/Log", TYPES).msg)

    monkeypatch.setattr(world.network, "receive_words", receive)
    return sentences


def error_code(reply: bytes) -> int:
    code: int = deserialize(reply, f"{ACTION}_GetResult_Response", TYPES).result.error_code
    return code


def book_earlier(world: World) -> None:
    """Lets a bridge before this one have a goal."""
    world.bridge._book.put(BOOKED)
    world.judge.actions[TIP].orphans[UUID] = list(BOOKED.joints)


def test_a_goal_that_is_accepted_while_the_bridge_ends_has_one_result(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.reopen()
    shutdown = Pool.shutdown

    def finish(pool: Pool, cancel_futures: bool = False) -> None:
        while pool.jobs:  # it runs already, so that the end of the threads waits for it
            pool.jobs.popleft()[0]()
        shutdown(pool, cancel_futures)

    monkeypatch.setattr(Pool, "shutdown", finish)
    with world.in_place():
        replies = world.deliver(Input(f"{TIP}/send_goal", SEND_GOAL, ATTACHMENT))
        describe_again(world)
        assert [it[4] for it in replies] == [1]
        (result,) = get_result(world)
    assert (result[4], error_code(result)) == (ABORTED, LOST)


def test_a_goal_that_its_client_sends_again_while_the_bridge_begins_is_accepted(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bridge before this one was killed before it answered; the daemon knows the goal."""
    book_earlier(world)
    booked, replies = GoalBook.goals, list[list[bytes]]()

    def come_first(book: GoalBook) -> list[BookedGoal]:
        if not replies:
            replies.append(world.deliver(Input(f"{TIP}/send_goal", SEND_GOAL, ATTACHMENT)))
        return booked(book)

    monkeypatch.setattr(GoalBook, "goals", come_first)
    world.reopen()
    with world.in_place():
        world.run_jobs()
        assert [it[4] for it in replies[0]] == [1]
        end = {"id": ID, "status": "succeeded", "code": 0, "message": "reached"}
        world.hear("result", json.dumps(end).encode())
        assert [it[4] for it in get_result(world)] == [SUCCEEDED]


def test_a_goal_of_a_daemon_that_dies_before_its_first_state_is_lost(world: World) -> None:
    book_earlier(world)
    world.reopen()
    with world.in_place():
        results = get_result(world)
        world.hear("gone", b"")
        world.clock.sleep(2 * goals.GONE_AFTER)
        assert results == []
        world.hear("gone", b"")
        assert [(it[4], error_code(it)) for it in results] == [(ABORTED, LOST)]


def test_clocks_that_jump_end_no_goal_and_forget_no_result(world: World) -> None:
    world.reopen()
    with world.in_place():
        send_goal(world)
        results = get_result(world)
        for jump in (-(10.0**6), 10.0**6):
            world.clock.epoch += jump
            world.hear("state", json.dumps(state()).encode())
            assert results == []
        end = {"id": ID, "status": "succeeded", "code": 0, "message": "reached"}
        world.hear("result", json.dumps(end).encode())
        world.clock.epoch -= 10.0**6
        assert get_result(world) == results
        assert [it[4] for it in results] == [SUCCEEDED]


def test_the_diagnostics_of_a_daemon_that_is_gone_are_stale(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.reopen()
    found: list[Any] = []
    health = world.bridge.node.health  # type: ignore[union-attr]
    monkeypatch.setattr(health, "publish", lambda fields: found.append(fields["status"][0]))
    with world.in_place():
        world.hear("state", json.dumps(state()).encode())
        for key in ("gone", "alive"):
            world.hear(key, b"")
            world.clock.sleep(10.0)
            world.hear("state", json.dumps(state()).encode())
    assert found[-2]["level"] == STALE
    assert found[-2]["message"] == "the daemon is gone; its last words were ready: holding"
    assert (found[-1]["level"], found[-1]["message"]) == (0, "ready: holding")


def test_set_points_that_the_daemon_refuses_are_told(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.reopen()
    sentences = said(world, monkeypatch)
    told = payloads()["diagnostics"]
    with world.in_place():
        world.hear("state", json.dumps(state()).encode())
        for refused in (3, 3, 5):
            counts = {"refused": refused, "last_refusal": "it is 0.31 s old"}
            world.hear("diagnostics", json.dumps({**told, "setpoint": counts}).encode())
            world.clock.sleep(10.0)
            world.hear("state", json.dumps(state()).encode())
    assert [it for it in sentences if "set-points" in it] == [
        "2 set-points are refused, the last because it is 0.31 s old"
    ]


@pytest.mark.parametrize(("sec", "verb"), [(0, "accepted"), (1_000_000_000, "refused")])
def test_a_path_of_old_poses_is_refused(world: World, monkeypatch: pytest.MonkeyPatch, sec: int, verb: str) -> None:
    monkeypatch.setattr(
        world.daemon, "request", lambda key, *_: {"travel_time": 0.5} if key == "arm" else {"accepted": True}
    )
    world.reopen()
    sentences = said(world, monkeypatch)
    poses = [pose_stamped(0.4, 2.9, stamp={"sec": sec + k}) for k in range(2)]
    with world.in_place():
        data = serialize({"poses": poses}, "nav_msgs/msg/Path", TYPES)
        world.deliver(Input("goal_path", data, ATTACHMENT))
        world.run_jobs()
    assert f"is {verb}" in sentences[-1]
