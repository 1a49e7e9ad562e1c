"""The payloads of `state` and `diagnostics`: their numbers and times, and what log and systemd are told."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from itertools import pairwise

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.messages.state import LoopTimes
from hyperbit.controller.planning.core.events import FromExecutor
from hyperbit.controller.planning.core.tasks import PrepareSearch
from hyperbit.controller.program import Diagnostics, Fault
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.desk import Desk

LOST = Fault("board-lost", "can0/3", "no heartbeat")
STATE, DIAGNOSTICS = "state", "diagnostics"


def published(desk: Desk, key: str) -> list[float]:
    """Takes the times of publications since the last call, up to now [s]."""
    times = [at for at, of in desk.publications if of == key]
    desk.publications.clear()
    return times


def test_the_state_of_an_arm_at_rest(desk: Desk) -> None:
    desk.pass_time(0.5)
    desk.show()
    state = desk.published["state"]
    assert (state["mode"], state["reason"], state["configuration"]) == ("ready", "holding", "0000")
    assert (state["commanded"], state["measured"], state["goal"]) == ([0] * 12, [0] * 12, None)
    assert (state["waypoint"], state["target"], state["obstacles"]) == (None, None, 0)
    assert (state["faults"], state["degraded"]) == ([], [])
    assert state["tip"]["position"] == pytest.approx(desk.tip(0, 0, 0, 0))
    desk.pass_time(0.03)
    desk.post(FromExecutor(Diagnostics(desk.now, LoopTimes(), [], [], "on", (), 0, 0)))
    desk.pass_time(0.005)
    assert desk.published["state"]["stamp"] == pytest.approx(desk.wall - 0.045, abs=0.01), "of the snapshot"
    assert json.dumps(state)


def test_the_tip_follows_the_measured_states(desk: Desk) -> None:
    desk.show(outputs=desk.packed(1, 2, 3, 4))
    state = desk.state()
    assert (state["configuration"], state["tip"]["position"]) == ("1234", pytest.approx(desk.tip(1, 2, 3, 4)))
    desk.show(known=b"\xfe\x0f")
    state = desk.state()
    assert (state["configuration"], state["tip"], state["measured"][0], state["commanded"]) == (None, None, None, None)


def test_without_an_executor_nothing_is_told_of_the_arm(small: Arm, small_densities: Densities) -> None:
    desk = Desk(small, small_densities)
    state = desk.state()
    assert (state["mode"], state["faults"], state["stamp"]) == ("starting", [], pytest.approx(desk.wall))
    assert (state["configuration"], state["commanded"], state["measured"]) == (None, None, [None] * 12)
    desk.executor.greet()
    desk.drop("the executor is gone")
    (fault,) = desk.state()["faults"]
    assert fault["message"] == "the executor is gone: the arm holds or does what `on_loss` says"
    assert desk.diagnostics()["executor"] == "the executor is gone"


def test_diagnostics_without_and_with_an_executor_that_tells_them(desk: Desk) -> None:
    told = desk.diagnostics()
    keys = {"stamp", "loop", "buses", "boards", "queues", "setpoint", "switches", "waits", "ledger", "real_time"}
    assert keys <= told.keys()
    assert (told["counts"], told["ledger"], told["queues"]) == ([], "ok", {"inbox": 0, "planning": 0})
    desk.post(FromExecutor(Diagnostics(desk.now, LoopTimes(ticks=100), [], [], "on", (1,) * 12, 3, 0)))
    desk.held = {PrepareSearch}
    desk.pass_time(0.5)
    told = desk.diagnostics()
    assert (told["switches"], told["waits"], told["executor"], told["real_time"]) == (12, 3, "connected", "on")
    assert json.dumps(told)
    assert "tracker" not in told


def test_the_end_of_a_prepared_search_publishes_no_state(small: Arm, small_densities: Densities) -> None:
    desk = Desk(small, small_densities)
    desk.held = {PrepareSearch}
    desk.executor.greet()
    desk.show()
    assert desk.diagnostics()["queues"]["inbox"] == 1
    desk.show()
    desk.publications.clear()
    desk.release(PrepareSearch)
    desk.settle()
    assert not published(desk, STATE)
    desk.show()
    assert published(desk, STATE)


def test_states_come_without_a_change_and_diagnostics_once_a_second(desk: Desk) -> None:
    desk.pass_time(1.0)
    desk.publications.clear()
    desk.notified.clear()
    desk.pass_time(3.0)
    assert len([at for at, key in desk.publications if key == STATE]) in range(45, 62)
    assert len(published(desk, DIAGNOSTICS)) in (3, 4)
    assert desk.notified in (["WATCHDOG=1"] * 3, ["WATCHDOG=1"] * 4)


def test_a_change_is_published_at_once_but_not_sooner_than_the_least_gap(desk: Desk) -> None:
    desk.pass_time(1.0)
    desk.publications.clear()
    for reason in ("one", "two", "three"):
        desk.executor.show(reason=reason)
    desk.pass_time(0.02)
    times = published(desk, STATE)
    assert times[0] < desk.now - 0.01
    assert min((later - at for at, later in pairwise(times)), default=1.0) >= 0.002 - 1e-6
    assert desk.published["state"]["reason"] == "three"


def test_faults_are_logged_once_with_their_fields_and_a_level(desk: Desk) -> None:
    desk.show(mode="fault", reason="a board is lost", faults=(LOST,))
    desk.pass_time(0.3)
    desk.show(mode="ready", reason="holding", faults=())
    desk.show(faults=(Fault("board-limits", "can0/3", "its heartbeat time is rounded"),))
    begun, over, limits = desk.lines
    assert (begun.level, begun.text) == (logging.ERROR, "board-lost: no heartbeat")
    assert (over.level, over.text) == (logging.INFO, "board-lost at can0/3 is over")
    assert begun.fields["HYPERBIT_BOARD"] == over.fields["HYPERBIT_BOARD"] == "3"
    assert begun.fields["MESSAGE_ID"] != over.fields["MESSAGE_ID"]
    assert (limits.level, limits.text) == (logging.WARNING, "board-limits: its heartbeat time is rounded")
    desk.lines.clear()
    desk.show(locked=b"\1")  # an operator may want it
    assert [line.level for line in desk.lines if line.text.startswith("degraded")] == [logging.WARNING]


def test_systemd_is_told_the_mode_when_it_changes_and_whether_the_boards_are_simulated(
    make_simulated: Callable[[], Desk], desk: Desk
) -> None:
    desk.settle()
    desk.show(mode="fault", reason="a board is lost")
    words = [text for text in desk.notified if text.startswith("STATUS")]
    assert words[-2:] == ["STATUS=ready: holding", "STATUS=fault: a board is lost"]
    simulated = make_simulated()
    simulated.settle()
    assert "STATUS=ready (simulated): holding" in simulated.notified
