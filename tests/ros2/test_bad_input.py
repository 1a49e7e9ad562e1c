"""Bad input and restarts that once did harm, one test each, on a bridge without a network."""

import json
import random
import struct
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.ros2 import goal_book
from hyperbit.controller.ros2.answers import GoalResult
from hyperbit.controller.ros2.arm_node import MOST_LETTERS
from hyperbit.controller.ros2.goal_book import BookedGoal, GoalBook
from hyperbit.controller.ros2.poses import BadGoal, waypoint
from hyperbit.controller.ros2.trajectories import actuator_goal, tip_goal
from hyperbit.controller.ros2.wire.cdr import serialize
from tests.ros2.client import CANCELED, SUCCEEDED
from tests.ros2.fuzz.inputs import ACTUATORS, TIP, Input, Inputs, payloads
from tests.ros2.fuzz.places import entries
from tests.ros2.fuzz.world import World
from tests.ros2.samples import ACTION, TYPES, chain, place, pose_stamped, state, trajectory_goal

ATTACHMENT = struct.pack("<qqB", 1, 10**18, 16) + bytes(16)
UUID = bytes(range(16))
ID = f"ros2-{UUID.hex()}"
TIP_GOAL = trajectory_goal(["tip_x", "tip_y"], [[0.4, 2.9]])
SEND_GOAL = serialize({"goal_id": {"uuid": UUID}, "goal": TIP_GOAL}, f"{ACTION}_SendGoal_Request", TYPES)


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(Inputs(random.Random(0)), tmp_path)
    world.reopen()
    return world


def call(world: World, name: str, type_name: str, fields: dict[str, Any]) -> list[bytes]:
    replies = world.deliver(Input(name, serialize(fields, type_name, TYPES), ATTACHMENT))
    world.run_jobs()
    return replies


def get_result(world: World, action: str = TIP) -> list[bytes]:
    return call(world, f"{action}/get_result", f"{ACTION}_GetResult_Request", {"goal_id": {"uuid": UUID}})


def describe_again(world: World) -> None:
    """Closes the node, and opens another one for the same arm, as a bridge that is started again does."""
    world.bridge.close()
    world.bridge.description = b""
    world.ask()
    world.hear(*world.waiting.popleft()[:2])


def send_goal(world: World) -> list[bytes]:
    replies = world.deliver(Input(f"{TIP}/send_goal", SEND_GOAL, ATTACHMENT))
    world.run_jobs()
    return replies


@pytest.mark.parametrize(
    "answer", [None, [], {}, {"accepted": "yes"}, {"accepted": True, "code": "x"}, {"accepted": 1}]
)
def test_an_answer_of_another_form_rejects_a_goal(world: World, monkeypatch: pytest.MonkeyPatch, answer: Any) -> None:
    monkeypatch.setattr(world.daemon, "request", lambda *_: answer)
    with world.in_place():
        for _ in range(70):  # more than can be open at once
            ((*_, accepted),) = (reply[:5] for reply in send_goal(world))
            assert not accepted
        for name in ("stop", "reset", "cancel"):
            (reply,) = call(world, name, "std_srvs/srv/Trigger_Request", {})
            assert not reply[4]
        assert len(call(world, "plan", "nav_msgs/srv/GetPlan_Request", {})) == 1


def test_a_result_of_another_form_ends_no_goal_and_harms_none(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world.daemon, "request", lambda *_: {"accepted": True})
    with world.in_place():
        (reply,) = send_goal(world)
        assert reply[4]
        results = get_result(world)
        good = {"id": ID, "status": "succeeded", "code": 0, "message": "reached"}
        for field, value in (("code", "x"), ("code", 2**31), ("status", None), ("message", 5), ("id", [])):
            world.hear("result", json.dumps({**good, field: value}).encode())
            assert results == []
        world.hear("result", json.dumps(good).encode())
        assert [it[4] for it in results] == [4]


@pytest.mark.parametrize(
    "fields", [{"stamp": [None]}, {"stamp": "x"}, {"stamp": 1e308}, {"faults": [5]}, {"measured": [1]}, {"tip": []}]
)
def test_a_state_of_another_form_is_not_published(world: World, fields: dict[str, Any]) -> None:
    with world.in_place():
        world.hear("state", json.dumps(state(**fields)).encode())
        assert "joint_states" not in world.network.published
        world.hear("state", json.dumps(state()).encode())
    assert "joint_states" in world.network.published


@pytest.mark.parametrize("field", ["frames", "drawing", "base", "name", "actuators", "dimension"])
def test_a_description_of_another_form_leaves_the_node(world: World, field: str) -> None:
    before = set(world.network.tokens)
    with world.in_place():
        world.hear("arm", json.dumps({**payloads()["arm"], field: None}).encode())
        assert world.network.tokens == before
        world.hear("arm", json.dumps({**payloads()["arm"], "name": "other", "version": "2"}).encode())
        assert {it.split("/")[7] for it in world.network.tokens} == {"%other"}


def test_numbers_that_overflow_are_refused() -> None:
    with pytest.raises(BadGoal, match=r"goal_pose: 1e\+308, expected at most 1e\+06"):
        waypoint(pose_stamped(1e308, 1e308), place(), "goal_pose", oriented=False)
    with pytest.raises(BadGoal, match=r"points\[0\]: -1e\+308"):
        tip_goal(trajectory_goal(["tip_x", "tip_y"], [[0.0, -1e308]]), place())


def test_a_goal_without_joints_is_refused() -> None:
    with pytest.raises(BadGoal, match="joint_names: none") as refused:
        actuator_goal(trajectory_goal([], [[]]), chain(), state()["measured"])
    assert refused.value.code == -2


def test_a_sentence_quotes_little(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    monkeypatch.setattr(world.network, "receive_words", lambda data: sizes.append(len(data)))
    with world.in_place():
        goal = trajectory_goal(["x" * 500_000], [[1.0]])
        call(world, f"{TIP}/send_goal", f"{ACTION}_SendGoal_Request", {"goal_id": {"uuid": UUID}, "goal": goal})
    assert sizes
    assert max(sizes) < 2 * MOST_LETTERS


def test_goals_of_topics_whose_results_are_lost_are_forgotten(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world.daemon, "request", lambda *_: {"accepted": True})
    message = Input("goal_pose", serialize(pose_stamped(0.4, 2.9), "geometry_msgs/msg/PoseStamped", TYPES), ATTACHMENT)
    with world.in_place():
        sizes = []
        for _ in range(3):
            for _ in range(100):
                world.clock.sleep(1.0)
                world.deliver(message)
                world.run_jobs()
            sizes.append(entries(world.bridge))
    assert sizes[1] == sizes[2]


def test_a_book_is_bounded_and_its_numbers_are_those_of_messages(tmp_path: Path) -> None:
    path = tmp_path / "goals.json"
    book = GoalBook(path)
    running = BookedGoal(UUID.hex(), "tip", ("tip_x",), 1)
    book.put(running)
    for k in range(2 * goal_book.MOST_GOALS):
        book.put(BookedGoal(f"{k:032x}", "tip", (), 1, GoalResult("succeeded"), ended=4e9))
    assert len(book.goals()) == goal_book.MOST_GOALS
    assert book.goals()[0] == running
    for wrong in (
        {"stamp": -1},
        {"stamp": 2**63},
        {"result": {"status": 5}},
        {"result": {"status": "x", "code": 2**31}},
    ):
        entry = {"uuid": UUID.hex(), "kind": "tip", "joints": [], "stamp": 1, **wrong}
        path.write_text(json.dumps([entry]))
        assert GoalBook(path).goals() == []


@pytest.mark.parametrize("restarted_before_its_end", [False, True])
def test_a_canceled_goal_stays_canceled_after_a_restart(
    world: World, monkeypatch: pytest.MonkeyPatch, restarted_before_its_end: bool
) -> None:
    monkeypatch.setattr(world.daemon, "request", lambda *_: {"accepted": True})
    cancel = {"goal_info": {"goal_id": {"uuid": UUID}}}
    end = json.dumps({"id": ID, "status": "canceled", "code": -1, "message": "canceled"}).encode()
    with world.in_place():
        send_goal(world)
        call(world, f"{TIP}/cancel_goal", "action_msgs/srv/CancelGoal_Request", cancel)
        if restarted_before_its_end:
            world.kill()
            world.restart()
            world.hear(*world.waiting.popleft()[:2])
        world.hear("result", end)
        (first,) = get_result(world)
        assert first[4] == CANCELED
        describe_again(world)
        assert get_result(world) == [first]


def test_an_id_of_the_other_action_is_rejected_and_harms_no_goal(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world.daemon, "request", lambda *_: {"accepted": True})
    switch = {"goal_id": {"uuid": UUID}, "goal": trajectory_goal(["1.left"], [[1.0]])}
    end = json.dumps({"id": ID, "status": "succeeded", "code": 0, "message": "reached"}).encode()
    with world.in_place():
        world.hear("state", json.dumps(state()).encode())
        (reply,) = send_goal(world)
        assert reply[4]
        for _ in range(2):  # while it runs, and after its end
            (reply,) = call(world, f"{ACTUATORS}/send_goal", f"{ACTION}_SendGoal_Request", switch)
            assert not reply[4]
            world.hear("result", end)
        assert [it[4] for it in get_result(world)] == [SUCCEEDED]
        describe_again(world)
        assert [it[4] for it in get_result(world)] == [SUCCEEDED]
