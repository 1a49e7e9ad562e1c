"""What goes wrong with actuators, boards and processes, and the way back."""

import dataclasses
import threading
import time

import can
import numpy as np
import pytest
from msgspec.structs import replace

from controller.config import Arm
from controller.daemon.service import Daemon, running, simulated
from controller.manipulator.notation import parse_configuration
from controller.motion import codes
from drivers import cia301
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing, Wiring
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, drain, syncs


def reset(client: Observer) -> None:
    assert client.ask("reset")["accepted"]
    client.wait_now("ready")


def first_to_switch(client: Observer, arm: Arm, goal: tuple[float, float]) -> tuple[str, int]:
    """The first actuator that a goal switches, and the state it is in now."""
    planned = client.ask("plan", waypoints=[{"position": goal}])["waypoints"][0]["configuration"]
    wanted = arm.manipulator.actuator_states(parse_configuration(arm.manipulator, planned))
    now = client.wait_now("ready")["measured"]
    k = int(np.flatnonzero(wanted != now)[0])
    return arm.manipulator.actuators[k], now[k]


def test_a_stuck_actuator_is_named_and_its_goal_aborted_once(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    result = client.result("a")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert label in result["message"]
    state = client.wait_for("fault")
    assert label in state["reason"]
    assert [fault["code"] for fault in state["faults"]] == ["stuck"]
    boards.fault("release", label)
    reset(client)
    client.move(RIGHT, goal="b")
    assert len(client.results("a")) == 1


def test_after_a_fault_planning_starts_from_what_was_measured(client: Observer, boards: Simulation, arm: Arm) -> None:
    label, state_now = first_to_switch(client, arm, RIGHT)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    client.wait_for("fault")
    reset(client)
    state = client.wait_now("ready")
    assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
    assert state["measured"][arm.manipulator.actuators.index(label)] == state_now
    planned = client.ask("plan", waypoints=[{"position": LEFT}])["waypoints"][0]
    wanted = arm.manipulator.actuator_states(parse_configuration(arm.manipulator, planned["configuration"]))
    assert planned["switches"] == np.count_nonzero(wanted != state["measured"])


def test_a_silent_board_is_a_fault_soon_and_reset_goes_on(
    client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC
) -> None:
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    silenced = time.time()
    boards.fault("silence", "can0/5")
    state = client.wait_for("fault")
    assert state["stamp"] - silenced < 5 * SLOWNESS, "a second is enough, but for a loaded machine"
    assert "can0/5" in state["reason"]
    assert [state is None for state in state["measured"]] == [channel.node == 5 for channel in arm.wiring]
    assert state["tip"] is None
    assert state["faults"][0]["code"] == "board-lost"
    result = client.result("a")
    assert (result["status"], result["position"]) == ("aborted", None)
    assert "can0/5" in result["message"]
    before = boards.positions().tolist()
    drain(listener)
    client.ask("reset")
    assert "can0/5" in client.wait_now("fault", "neither booted nor answered")["reason"]
    boards.fault("unsilence", "can0/5")
    reset(client)
    assert syncs(drain(listener)) == []
    assert boards.positions().tolist() == before
    client.move(RIGHT, goal="b")
    assert len(client.results("a")) == 1


def test_a_board_that_lost_its_power_is_a_fault_and_reset_configures_it_anew(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    client.move(RIGHT)
    before = boards.positions()
    its = np.array([channel.node == 7 for channel in arm.wiring])
    boards.fault("power_cut", "can0/7")
    boards.fault("power_on", "can0/7")
    assert "can0/7" in client.wait_for("fault")["reason"]
    eventually(lambda: not boards.positions()[its].any())
    reset(client)
    after = boards.positions()
    assert not after[its].any(), "reset moved the board's actuators"
    assert after[~its].tolist() == before[~its].tolist()
    assert client.wait_now("ready")["measured"] == after.astype(int).tolist()
    client.move(MIDDLE, goal="b")


def test_a_missing_board_at_start_is_named_and_may_come_later(
    boards: Simulation, bench: Bench, listener: can.BusABC
) -> None:
    boards.fault("silence", "can0/3")
    bench.run()
    client = bench.observer()
    assert "can0/3" in client.wait_for("fault")["reason"]
    refused = client.goal(MIDDLE)
    assert not refused["accepted"]
    assert "can0/3" in refused["message"]
    boards.fault("unsilence", "can0/3")
    reset(client)
    assert syncs(drain(listener)) == []
    client.move(MIDDLE)


@pytest.fixture
def starting(boards: Simulation, bench: Bench) -> Observer:
    """A client of a daemon that waits long for board can0/3, which has no power."""
    patient = replace(bench.arm.settings, boards=replace(bench.arm.settings.boards, boot_timeout=2 * PATIENCE))
    bench.arm = dataclasses.replace(bench.arm, settings=patient)
    boards.fault("power_cut", "can0/3")
    bench.run()
    client = bench.observer()
    client.wait_for("starting")
    return client


def test_a_goal_while_starting_is_refused_with_the_reason(starting: Observer, boards: Simulation) -> None:
    answer = starting.goal(MIDDLE, id="a")
    assert (answer["accepted"], answer["id"]) == (False, "a")
    assert answer["message"] == "the arm is starting: the boards are being brought up"
    boards.fault("power_on", "can0/3")
    starting.wait_for("ready")
    starting.move(MIDDLE)
    assert starting.results("a") == []


def test_a_stop_while_starting_stays_until_reset(starting: Observer, boards: Simulation) -> None:
    starting.ask("stop")
    starting.ask("reset")  # the first start-up is still under way
    starting.ask("stop")
    boards.fault("power_on", "can0/3")
    starting.wait_now("stopped")
    starting.ask("reset")
    starting.wait_now("ready")
    starting.move(MIDDLE)


def test_another_master_is_a_fault(client: Observer, listener: can.BusABC) -> None:
    listener.send(cia301.frame(cia301.SYNC))
    state = client.wait_for("fault")
    assert state["faults"][0]["code"] == "foreign-master"
    reset(client)


def test_a_daemon_that_dies_and_comes_back_finds_the_arm_as_it_is(
    wiring: Wiring, timing: Timing, bench: Bench, listener: can.BusABC
) -> None:
    with simulated(wiring, timing) as boards:
        with running(bench.daemon()):
            first = bench.observer()
            first.wait_for("ready")
            first.move(RIGHT)
            first.goal(MIDDLE, LEFT, times=[HOUR, 2 * HOUR], id="never")
        before, switches = boards.positions().tolist(), boards.switches().tolist()
        assert first.result("never")["message"] == "the daemon is shutting down; the arm holds"
        drain(listener)
        with running(bench.daemon()):
            second = bench.observer()
            state = second.wait_for("ready")
            assert state["measured"] == [int(position) for position in before]
            assert syncs(drain(listener)) == []
            assert boards.positions().tolist() == before
            assert boards.switches().tolist() == switches
            second.move(MIDDLE)
            assert second.results("never") == []


@pytest.mark.parametrize("pause", [0.35, 0.4, 0.45])
def test_a_daemon_that_comes_back_just_when_the_boards_miss_the_last_one_brings_them_up(
    wiring: Wiring, timing: Timing, bench: Bench, pause: float
) -> None:
    with simulated(wiring, timing):
        with running(bench.daemon()):
            bench.observer().wait_for("ready")
        gone = time.monotonic()
        again = bench.daemon()
        eventually(lambda: time.monotonic() - gone >= pause * SLOWNESS)
        with running(again):
            assert bench.observer().wait_for("ready")["faults"] == []


def test_a_closed_daemon_leaves_no_thread(daemon: Daemon, bench: Bench, client: Observer) -> None:
    client.move(MIDDLE)
    bench.stack.close()
    ours = {"control", "planner", "outbox", "telemetry", "ledger"}
    eventually(lambda: not ours & {thread.name for thread in threading.enumerate()})
