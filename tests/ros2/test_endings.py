"""What ends motion: it waits for nothing, overtakes what asks for motion, and is repeated until the goal has ended."""

import json
import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.network.client import Unanswered
from hyperbit.controller.ros2 import goals
from hyperbit.controller.ros2.goal_book import MOST_OWED
from hyperbit.controller.ros2.wire.cdr import serialize
from tests.ros2.client import ABORTED, CANCELED, CANCELING, SUCCEEDED, Reading
from tests.ros2.fuzz.inputs import TIP, Input, Inputs
from tests.ros2.fuzz.stand_ins import Killed
from tests.ros2.fuzz.world import MOTION, World
from tests.ros2.samples import ACTION, TYPES, pose_stamped, trajectory_goal
from tests.ros2.test_bad_input import ATTACHMENT, ID, SEND_GOAL, UUID, describe_again, get_result, send_goal

TRIGGER, PLAN = "std_srvs/srv/Trigger_Request", "nav_msgs/srv/GetPlan_Request"
TURN, YEAR = 0.5, 31_536_000  # [s]
CANCEL = ("cancel", ID)


class Daemon:
    """A daemon that carries out nothing by itself.

    Attributes:
        away: keys whose requests are not answered.
    """

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.ends: dict[str, dict[str, Any]] = {}
        self.away: set[str] = set()
        self.known = True

    def request(self, key: str, payload: Mapping[str, Any]) -> dict[str, Any]:
        self.asked.append((key, str(payload.get("id", ""))))
        if key in self.away:
            raise Unanswered("no daemon")
        if key == "result":
            found = self.ends.get(payload["id"])
            return {"result": found} if self.known or found else {"reason": "unknown-goal"}
        return {"accepted": True}

    def end(self, status: str = "canceled") -> None:
        self.ends[ID] = {"id": ID, "status": status, "code": -1, "message": "so it is"}

    def count(self, key: str, name: str = "") -> int:
        return self.asked.count((key, name))


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(Inputs(random.Random(0)), tmp_path)
    world.reopen()
    return world


@pytest.fixture
def daemon(world: World, monkeypatch: pytest.MonkeyPatch) -> Daemon:
    daemon = Daemon()
    monkeypatch.setattr(world.daemon, "request", daemon.request)
    return daemon


def ask(world: World, name: str, type_name: str = TRIGGER, **fields: Any) -> list[bytes]:
    return world.deliver(Input(name, serialize(fields, type_name, TYPES), ATTACHMENT))


def cancel(world: World) -> list[bytes]:
    name, type_name = f"{TIP}/cancel_goal", "action_msgs/srv/CancelGoal_Request"
    return ask(world, name, type_name, goal_info={"goal_id": {"uuid": UUID}})


def pass_turns(world: World, seconds: float, but: str = "") -> None:
    for _ in range(round(seconds / TURN)):
        world.clock.sleep(TURN)
        world.hear("feedback", b"{}")
        world.run_jobs(but)
        world.judge.end_turn(there=True)


def crowd(world: World) -> list[list[bytes]]:
    start = {"header": {"frame_id": "world"}}
    plans = [ask(world, "plan", PLAN, start=start, goal=pose_stamped(0.4, 2.9)) for _ in range(64)]
    assert not any(plans)
    return plans


def restart(world: World) -> None:
    world.restart()
    world.hear(*world.waiting.popleft()[:2])


def status(world: World) -> int:
    return world.judge.actions[TIP].goals[UUID].status


@pytest.mark.parametrize("key", ["stop", "cancel"])
def test_a_stop_waits_for_no_plan(world: World, daemon: Daemon, key: str) -> None:
    with world.in_place():
        plans = crowd(world)
        replies = ask(world, key)
        world.run_jobs(but=MOTION)
        assert [it[4] for it in replies] == [1]
        assert daemon.asked == [(key, "")]
        world.run_jobs()
        assert all(plans)


def test_a_cancel_waits_for_no_plan(world: World, daemon: Daemon) -> None:
    with world.in_place():
        assert send_goal(world)[0][4]
        crowd(world)
        assert cancel(world)[0][4] == 0
        world.run_jobs(but=MOTION)
        assert daemon.asked[-1] == CANCEL
        daemon.end()
        pass_turns(world, 3.0, but=MOTION)
        assert status(world) == CANCELED


@pytest.mark.parametrize(("key", "barred"), [("stop", {"goal", "reset"}), ("cancel", {"goal"})])
def test_what_came_before_a_stop_is_not_sent_after_it(world: World, daemon: Daemon, key: str, barred: set[str]) -> None:
    with world.in_place():
        accepted = world.deliver(Input(f"{TIP}/send_goal", SEND_GOAL, ATTACHMENT))
        ask_pose(world)
        reset = ask(world, "reset")
        ask(world, key)
        world.run_jobs()
        assert barred.isdisjoint(it for it, _ in daemon.asked)
        assert [it[4] for it in accepted] == [0]
        assert [it[4] for it in reset] == ["reset" not in barred]
        assert send_goal(world)[0][4], "what comes later is sent"


def ask_pose(world: World) -> None:
    fields = {"header": {"frame_id": "world"}, "pose": {"position": {"x": 0.4, "y": 2.9}}}
    ask(world, "goal_pose", "geometry_msgs/msg/PoseStamped", **fields)


@pytest.mark.parametrize("answered", [True, False])
def test_an_accepted_cancel_is_repeated_until_the_goal_has_ended(world: World, daemon: Daemon, answered: bool) -> None:
    with world.in_place():
        send_goal(world)
        daemon.away = set() if answered else {"cancel"}
        cancel(world)
        pass_turns(world, 20.0)
        assert daemon.count(*CANCEL) > 10
        assert status(world) == CANCELING
        daemon.away.clear()
        daemon.end()
        pass_turns(world, 3.0)
        assert status(world) == CANCELED
        before = daemon.count(*CANCEL)
        pass_turns(world, 5.0)
        assert daemon.count(*CANCEL) == before


@pytest.mark.parametrize("kill_before_the_answer", [True, False])
def test_an_accepted_cancel_survives_a_kill(world: World, daemon: Daemon, kill_before_the_answer: bool) -> None:
    with world.in_place():
        send_goal(world)
        if kill_before_the_answer:
            replies, world.faulty = world.on_reply, True

            def die(*_: Any) -> None:
                world.kill()
                raise Killed

            world.on_reply = die  # type: ignore[method-assign]
            with pytest.raises(Killed):
                cancel(world)
            world.on_reply, world.faulty = replies, False  # type: ignore[method-assign]
        else:
            cancel(world)
            world.kill()
        assert daemon.count(*CANCEL) == 0
        restart(world)
        pass_turns(world, 4.0)
        assert daemon.count(*CANCEL) > 1
        daemon.end()
        pass_turns(world, 3.0)
        assert status(world) == CANCELED


@pytest.mark.parametrize("killed", [True, False])
def test_a_cancel_is_owed_though_the_goal_was_told_to_be_lost(world: World, daemon: Daemon, killed: bool) -> None:
    with world.in_place():
        send_goal(world)
        daemon.away = {"cancel", "result"}
        cancel(world)
        world.hear("gone", b"")
        pass_turns(world, 2 * goals.GONE_AFTER)
        assert status(world) == ABORTED
        if killed:
            world.kill()
            restart(world)
        daemon.away.clear()
        before = daemon.count(*CANCEL)
        world.hear("alive", b"")
        pass_turns(world, 3.0)
        assert daemon.count(*CANCEL) > before
        daemon.end()
        pass_turns(world, 3.0)
        assert world.judge.debts == {}
        assert status(world) == ABORTED, "one goal, one result"


def send_within(world: World, seconds: float) -> None:
    """Sends a goal that is to end at most this long after the time of its last point [s]."""
    within = {"sec": math.floor(seconds), "nanosec": round(seconds % 1 * 1e9)}
    goal = trajectory_goal(["tip_x", "tip_y"], [[0.5, 2.9], [0.4, 2.9]], goal_time_tolerance=within)
    ask(world, f"{TIP}/send_goal", f"{ACTION}_SendGoal_Request", goal_id={"uuid": UUID}, goal=goal)
    world.run_jobs()


@pytest.mark.parametrize("years", [-20, 0, 20])
@pytest.mark.parametrize("killed", [True, False])
def test_a_goal_that_exceeds_its_time_is_canceled_and_ends_outside_its_tolerance(
    world: World, daemon: Daemon, killed: bool, years: int
) -> None:
    """Also if the system's clock is set meanwhile."""
    with world.in_place():
        send_within(world, 4.5)  # after the last point, at 1 s
        world.clock.epoch += years * YEAR
        if killed:
            world.kill()
            restart(world)
        pass_turns(world, 5.0)
        assert daemon.count(*CANCEL) == 0
        pass_turns(world, 3.0)
        assert daemon.count(*CANCEL) > 1
        results = get_result(world)
        daemon.end()
        pass_turns(world, 3.0)
        assert status(world) == ABORTED
        reading = Reading(results[0])
        assert (reading.get("b"), reading.get("i")) == (ABORTED, goals.TOO_LATE)
        assert "goal_time_tolerance" in reading.text()


def test_a_client_may_cancel_a_goal_that_exceeds_its_time(world: World, daemon: Daemon) -> None:
    with world.in_place():
        send_within(world, 1.0)
        pass_turns(world, 4.0)
        assert cancel(world)[0][4] == 0
        daemon.end()
        pass_turns(world, 3.0)
        assert status(world) == CANCELED


@pytest.mark.parametrize("seconds", [0.0, -1.0])
def test_a_goal_without_a_time_tolerance_may_take_any_time(world: World, daemon: Daemon, seconds: float) -> None:
    with world.in_place():
        send_within(world, seconds)
        pass_turns(world, 60.0)
        assert daemon.count(*CANCEL) == 0


def test_a_bridge_that_ends_leaves_accepted_cancels_to_the_next(world: World, daemon: Daemon) -> None:
    with world.in_place():
        send_goal(world)
        cancel(world)
        describe_again(world)
        assert status(world) == ABORTED
        before = daemon.count(*CANCEL)
        assert before == 1, "it is sent before the end"
        pass_turns(world, 3.0)
        assert daemon.count(*CANCEL) > before


def test_a_goal_that_is_rejected_without_an_answer_is_canceled(world: World, daemon: Daemon) -> None:
    """The daemon may have it, or receive it later."""
    daemon.away, daemon.known = {"goal"}, False
    with world.in_place():
        assert not send_goal(world)[0][4]
        daemon.away.clear()
        assert not send_goal(world)[0][4], "the id is that of the goal that is to be canceled"
        world.kill()
        restart(world)
        pass_turns(world, goals.KNOWN_WITHIN - 1)
        assert daemon.count(*CANCEL) > 10
        pass_turns(world, 4.0)
        assert world.judge.debts == {}
        assert send_goal(world)[0][4]


def test_a_goal_of_a_topic_without_an_answer_is_canceled(world: World, daemon: Daemon) -> None:
    daemon.away = {"goal"}
    with world.in_place():
        ask_pose(world)
        world.run_jobs()
        (name,) = [it for key, it in daemon.asked if key == "goal"]
        pass_turns(world, 3.0)
        assert daemon.count("cancel", name) > 1
        daemon.ends[name] = {"status": "canceled"}
        pass_turns(world, 3.0)
        assert world.judge.debts == {}


def test_no_goal_begins_while_too_many_cancels_are_owed(world: World, daemon: Daemon) -> None:
    daemon.away = {"goal", "cancel", "result"}
    with world.in_place():
        for _ in range(MOST_OWED + 10):
            ask_pose(world)
            world.run_jobs()
        assert len([key for key, _ in daemon.asked if key == "goal"]) == MOST_OWED
        daemon.away.clear()
        assert not send_goal(world)[0][4]


def test_an_ended_goal_does_not_run_again_after_a_restart(world: World, daemon: Daemon) -> None:
    with world.in_place():
        send_goal(world)
        daemon.end("succeeded")
        world.hear("result", json.dumps(daemon.ends[ID]).encode())
        (before,) = get_result(world)
        world.kill()
        restart(world)  # the judge sees each status
        assert get_result(world) == [before]
        assert status(world) == SUCCEEDED
