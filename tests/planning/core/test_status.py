"""The payloads of `state` and `diagnostics`, and their publication, on a simulated clock."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.motion.tracking.tracking import tracking_of
from hyperbit.controller.planning.core.events import Publish
from hyperbit.controller.planning.core.premises import TipBiasEstimator
from hyperbit.controller.planning.core.status import Status
from hyperbit.controller.planning.core.stream import Stream
from hyperbit.controller.planning.core.tasks import PrepareSearch
from hyperbit.controller.program import Diagnostics, Fault
from hyperbit.controller.workspace.densities import Densities
from tests.planning.conftest import DOCUMENT, JOINT, unused_states
from tests.planning.rig.desk import Desk
from tests.planning.rig.played_core import PlayedCore, PlayedGoal

HOME = (0, 0, 0, 0)
STUCK = Fault("stuck", "1.left", "it reads contracted")
LOST = Fault("board-lost", "can0/3", "no heartbeat")
UNWRITTEN = Fault("ledger-unwritten", "ledger", "the disk is full")
TICK = 0.001  # [s] of the simulated clock


class StatusBench(PlayedCore):
    def __init__(self, arm: Arm, tracker: TrackerSettings | None = None) -> None:
        super().__init__(arm)
        tip_bias = None if tracker is None else TipBiasEstimator(self.parts, self.locks, tracker)
        self.premises = premises = self.premises._replace(tip_bias=tip_bias)
        tracking = tracking_of(arm.manipulator.length, arm.tolerance)
        stream = Stream(arm, tracking, self.parts, premises, self.programs)
        self.goals, self.queries = SimpleNamespace(all=[]), SimpleNamespace(waiting=0)
        self.status = Status(self.parts, premises, self.programs, self.goals, self.queries, stream)

    def state(self) -> dict[str, Any]:
        return dict(self.status.state())

    def diagnostics(self) -> dict[str, Any]:
        return dict(self.status.diagnostics())

    def report(self, changed: bool = True) -> None:
        self.status.changed |= changed
        self.status.report()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            if self.now >= self.status.due:
                self.report(changed=False)
            self.advance(TICK)

    def published(self, key: str) -> list[Any]:
        kept, payloads = self.take(Publish), list[Any]()
        for action in kept:
            if action.key == key:
                payloads.append(action.payload)
            else:
                self.actions.append(action)
        return payloads


@pytest.fixture
def bench(small: Arm) -> StatusBench:
    return StatusBench(small)


def test_the_state_of_an_arm_at_rest(bench: StatusBench) -> None:
    bench.show()
    bench.advance(0.03)
    state = bench.state()
    assert (state["mode"], state["reason"], state["configuration"]) == ("ready", "holding", "0000")
    assert (state["commanded"], state["measured"], state["goal"]) == ([0] * 12, [0] * 12, None)
    assert (state["waypoint"], state["target"], state["obstacles"]) == (None, None, 1)
    assert (state["faults"], state["degraded"]) == ([], [])
    assert state["tip"]["position"] == pytest.approx(bench.tip(*HOME))
    assert state["stamp"] == pytest.approx(bench.wall - 0.03), "of the snapshot"
    assert json.dumps(state)


def test_actuators_that_nobody_has_read_back_are_named(bench: StatusBench) -> None:
    bench.show(unread=bytes([0b10, 0b1]))
    assert bench.state()["unread"] == ["1.diagonal", "3.right"]
    bench.show(unread=b"")
    assert bench.state()["unread"] == []


def test_the_tip_follows_the_measured_states(bench: StatusBench) -> None:
    bench.show()
    bench.state()
    bench.show(outputs=bench.states(1, 2, 3, 4))
    state = bench.state()
    assert (state["configuration"], state["tip"]["position"]) == ("1234", pytest.approx(bench.tip(1, 2, 3, 4)))
    bench.show(known=b"\xfe\x0f")
    state = bench.state()
    assert (state["configuration"], state["tip"], state["measured"][0]) == (None, None, None)


def test_what_depends_on_measured_states_is_computed_once(bench: StatusBench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.show()
    first = bench.state()
    monkeypatch.setattr(type(bench.arm.manipulator), "tips", None)
    bench.show()
    assert bench.state()["tip"] == first["tip"]


def test_the_running_goal_is_told(bench: StatusBench) -> None:
    target = {"position": [1.0, 0.0], "orientation": None}
    bench.programs.current = PlayedGoal({"goal": "a", "waypoint": 1, "target": target})
    bench.show(mode="executing")
    state = bench.state()
    assert (state["goal"], state["waypoint"], state["target"]) == ("a", 1, target)
    assert state["progress"] == {"ends": pytest.approx(bench.wall - bench.now)}


def test_locked_actuators_are_told_by_the_planner_only(bench: StatusBench) -> None:
    bench.locks.states = np.array([-1, 1] + [-1] * 10, np.int8)
    bench.show(faults=(Fault("degraded", "1.left", "the executor's words"), LOST))
    label = bench.arm.manipulator.actuators[1]
    state = bench.state()
    assert state["degraded"] == [{"actuator": label, "state": 1}]
    assert [(fault["code"], fault["source"]) for fault in state["faults"]] == [
        ("board-lost", "can0/3"), ("degraded", label),
    ]  # fmt: skip


def test_a_collision_where_the_arm_stands_is_a_fault(bench: StatusBench) -> None:
    bench.obstacles.standing = "module 2 is in table"
    bench.show()
    (fault,) = bench.state()["faults"]
    assert (fault["code"], fault["source"]) == ("in-obstacle", "arm")
    assert fault["message"].startswith("module 2 is in table: the arm holds")


def test_measured_states_that_are_no_configuration_are_a_fault(read: Callable[[Any], Arm]) -> None:
    bench = StatusBench(read({**DOCUMENT, "modules": [JOINT]}))
    bench.show(outputs=bytes([unused_states(bench.arm)]))
    (fault,) = bench.state()["faults"]
    assert (fault["code"], bench.state()["mode"]) == ("unknown-state", "ready")
    bench.show(moving=True)
    assert bench.state()["faults"] == []


def test_warnings_come_after_faults_and_once(bench: StatusBench) -> None:
    bench.show(faults=(STUCK,))
    bench.status.warnings = (Fault("stuck", "1.left", "said twice"), UNWRITTEN)
    assert bench.state()["faults"] == [
        {"code": "stuck", "source": "1.left", "message": "it reads contracted"},
        {"code": "ledger-unwritten", "source": "ledger", "message": "the disk is full"},
    ]
    assert bench.diagnostics()["ledger"] == "the disk is full"
    bench.status.warnings = ()
    assert len(bench.state()["faults"]) == 1
    assert bench.diagnostics()["ledger"] == "ok"


def test_before_the_first_connection_the_arm_is_starting_and_a_lost_executor_is_told(bench: StatusBench) -> None:
    state = bench.state()
    assert (state["mode"], state["faults"], state["stamp"]) == ("starting", [], bench.wall)
    bench.show()
    bench.view.lost("the executor is gone")
    state = bench.state()
    assert (state["mode"], [fault["code"] for fault in state["faults"]]) == ("fault", ["executor-lost"])
    assert state["faults"][0]["message"] == "the executor is gone: the arm holds or does what `on_loss` says"
    assert (state["configuration"], state["commanded"], state["measured"]) == (None, None, [None] * 12)
    assert bench.diagnostics()["executor"] == "the executor is gone"


def test_the_end_of_a_prepared_search_publishes_no_state(small: Arm, small_densities: Densities) -> None:
    desk = Desk(small, small_densities)
    desk.held = {PrepareSearch}
    desk.executor.greet()
    desk.show()
    assert desk.diagnostics()["queues"]["inbox"] == 1
    desk.show()
    desk.published.clear()
    desk.release(PrepareSearch)
    desk.settle()
    assert "state" not in desk.published
    desk.show()
    assert "state" in desk.published


def test_diagnostics_without_and_with_an_executor(bench: StatusBench) -> None:
    told = bench.diagnostics()
    keys = {"stamp", "loop", "buses", "boards", "queues", "setpoint", "switches", "waits", "ledger", "real_time"}
    assert keys <= told.keys()
    assert (told["counts"], told["ledger"], told["queues"]) == ((), "ok", {"inbox": 0, "planning": 0})
    bench.show()
    basis = bench.premises.basis()
    assert basis is not None
    bench.jobs.start(PrepareSearch(basis), lambda *_: None)
    bench.goals.all, bench.queries.waiting, bench.view.counted = [None], 1, 4
    bench.view.diagnostics = Diagnostics(bench.now, {"ticks": 100}, [], [], "on", (1,) * 12, 3, 0)
    bench.advance(0.5)
    told = bench.diagnostics()
    assert (told["switches"], told["waits"], told["executor"], told["real_time"]) == (8, 3, "connected", "on")
    assert told["queues"] == {"inbox": 1, "planning": 2}
    assert told["stamp"] == pytest.approx(bench.wall - 0.5)
    assert "tracker" not in told
    assert json.dumps(told)


def test_the_tip_bias_is_told_if_there_is_a_tracker(small: Arm) -> None:
    bench = StatusBench(small, TrackerSettings(noise=1e-4, clamp=0.01))
    assert bench.state()["bias"] == [0, 0]
    assert bench.diagnostics()["tracker"]["received"] == 0


def test_states_come_without_a_change_and_diagnostics_once_a_second(bench: StatusBench) -> None:
    bench.show()
    bench.run(3.0)
    assert len(bench.published("state")) in range(45, 62)
    assert len(bench.published("diagnostics")) in (3, 4)
    assert [word.text for word in bench.take(Notify)] == ["STATUS=ready: holding"] + ["WATCHDOG=1"] * 3


def test_a_change_is_published_at_once_but_not_sooner_than_the_least_gap(bench: StatusBench) -> None:
    bench.show()
    bench.report()
    bench.advance(0.01)
    bench.report(changed=False)
    assert len(bench.published("state")) == 1
    bench.show(reason="a new one")
    bench.report()
    assert [state["reason"] for state in bench.published("state")] == ["a new one"]
    bench.advance(0.0005)
    bench.show(reason="the last")
    bench.report()
    assert bench.published("state") == []
    assert bench.status.due == pytest.approx(bench.now + 0.0015)
    bench.run(0.004)
    assert [state["reason"] for state in bench.published("state")] == ["the last"]


def test_faults_are_logged_once_with_their_fields(bench: StatusBench) -> None:
    bench.show(mode="fault", reason="a board is lost", faults=(LOST,))
    bench.status.warnings = (Fault("clock-set", "clock", "the clock was set"),)
    bench.run(0.3)
    bench.show(mode="ready", reason="holding", faults=())
    bench.run(0.3)
    begun, over = bench.take(Log)
    assert (begun.level, begun.text) == (logging.ERROR, "board-lost: no heartbeat")
    assert (over.level, over.text) == (logging.INFO, "board-lost at can0/3 is over")
    assert begun.fields["HYPERBIT_BOARD"] == over.fields["HYPERBIT_BOARD"] == "3"
    assert begun.fields["MESSAGE_ID"] != over.fields["MESSAGE_ID"]


def test_what_does_not_keep_the_arm_from_moving_is_logged_as_a_warning(bench: StatusBench) -> None:
    bench.show(mode="fault", faults=(Fault("board-limits", "can0/3", "its heartbeat time is rounded"),))
    bench.run(0.3)
    bench.locks.states[0] = 1  # an operator may want it
    bench.show()
    bench.run(0.3)
    assert [(line.level, line.text) for line in bench.take(Log) if line.level > logging.INFO] == [
        (logging.WARNING, "board-limits: its heartbeat time is rounded"),
        (logging.WARNING, "degraded: locked"),
    ]


def test_systemd_is_told_the_mode_when_it_changes_and_whether_the_boards_are_simulated(bench: StatusBench) -> None:
    bench.show()
    bench.run(0.2)
    bench.show(mode="fault", reason="a board is lost")
    bench.report()
    words = [word.text for word in bench.take(Notify)]
    assert words == ["STATUS=ready: holding", "WATCHDOG=1", "STATUS=fault: a board is lost"]

    bench.parts.simulated = True
    bench.show(mode="ready", reason="holding")
    bench.run(0.2)
    assert "STATUS=ready (simulated): holding" in [word.text for word in bench.take(Notify)]
