"""The payloads of `state` and `diagnostics`, on a played executor."""

import pytest

from controller.program import Fault
from tests.planning.conftest import Desk
from tests.planning.executor import Inbox
from tests.planning.test_goals import A, B, taken
from tests.waiting import eventually

HOME = (0, 0, 0, 0)


def test_state_and_diagnostics_tell_what_they_did(desk: Desk) -> None:
    state = desk.planning.state()
    assert (state["mode"], state["reason"], state["configuration"]) == ("ready", "holding", "0000")
    assert (state["commanded"], state["measured"], state["goal"]) == ([0] * 12, [0] * 12, None)
    assert (state["waypoint"], state["faults"], state["degraded"]) == (None, [], [])
    assert state["tip"]["position"] == pytest.approx(desk.tip(*HOME))
    told = desk.planning.diagnostics()
    keys = {"stamp", "loop", "buses", "boards", "queues", "setpoint", "switches", "waits", "ledger", "real_time"}
    assert keys <= told.keys()
    assert told["counts"] == []
    assert (told["ledger"], told["queues"]) == ("ok", {"inbox": 0, "planning": 0})
    assert desk.planning.description()["name"] == "small"


def test_target_and_waypoints_of_the_running_goal_are_told(desk: Desk) -> None:
    assert desk.planning.description(["running"])["running"] is None
    taken(desk, A, B, step=10)
    told = desk.planning.description(["running"])["running"]
    assert [waypoint["t"] for waypoint in told["waypoints"]] == [0, 10]
    assert told["waypoints"][1]["position"] == pytest.approx(desk.tip(*B))
    assert told["waypoints"][1]["orientation"] is None
    state = desk.planning.state()
    assert state["target"]["position"] == pytest.approx(desk.tip(*A))
    assert state["goal"] == told["goal"]


def test_the_description_tells_what_boards_cannot_do(desk: Desk) -> None:
    assert desk.planning.description()["limits"] == []
    limit = Fault("board-limits", "can0/5", "board can0/5: RPDO1 refuses to wait for SYNC")
    desk.executor.show(faults=(limit, Fault("bus-passive", "can0", "can0 is error-passive")))
    eventually(lambda: desk.planning.description()["limits"])
    assert desk.planning.description()["limits"] == [limit.message]


def test_a_lost_executor_is_told(desk: Desk) -> None:
    desk.executor.greets = False
    desk.executor.drop()
    eventually(lambda: desk.planning.state()["mode"] == "fault")
    state = desk.planning.state()
    assert [fault["code"] for fault in state["faults"]] == ["executor-lost"]
    assert (state["configuration"], state["commanded"], state["measured"]) == (None, None, [None] * 12)
    inbox = Inbox()
    desk.planning.stop(inbox.replying("stop"))
    assert "the executor is not connected" in inbox.next("stop")["message"]
