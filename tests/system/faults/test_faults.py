"""Boards, actuators and a second master fail: the fault names the source, nothing moves, and the arm can recover."""

import time
from collections.abc import Callable

import can
import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.refusals import codes
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.arms import QUICK
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, first_to_switch, states_at
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

pytestmark = pytest.mark.arm(boards=QUICK)


def running(client: Observer, goal: str = "a") -> None:
    """Sends a goal that runs for two hours."""
    client.move(MIDDLE, goal=f"{goal} before")
    assert client.goal(MIDDLE, RIGHT, LEFT, times=[0, HOUR, 2 * HOUR], id=goal)["accepted"]
    client.wait_for("executing", f"goal {goal}")


def aborted(client: Observer, goal: str, word: str) -> None:
    result = client.result(goal)
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert word in result["message"]


def refused_for(client: Observer, cause: str) -> bool:
    """Sends a goal, which must be refused; returns whether the refusal names a cause."""
    refused = client.goal(RIGHT, id="refused")
    assert not refused["accepted"]
    return cause in refused["message"]


STALLED = {"halted", "emergency", "board-stopped", "board-lost"}  # faults that a busy machine may add


def ready_by_itself(client: Observer, boards: Simulation, since: float) -> None:
    """Waits until the arm is ready again, still in its measured state, and runs a fresh goal.

    A reset is sent only if a stall of the executor or of the boards has added faults that need one.
    """

    def ready() -> dict | None:
        if client.state["mode"] == "fault" and set(client.codes) & STALLED and not set(client.codes) <= {"board-lost"}:
            client.ask("reset")
        return next((s for s in client.heard["state"] if s["stamp"] > since and s["mode"] == "ready"), None)

    state = eventually(ready)
    assert state["faults"] == []
    assert state["goal"] is None
    assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
    client.move(RIGHT, goal="after")


def test_a_stuck_actuator_is_named_and_its_goal_aborted_once(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    aborted(client, "a", label)
    state = client.wait_now("fault")
    assert label in state["reason"]
    assert [fault["code"] for fault in state["faults"]] == ["stuck"]
    boards.fault("release", label)
    eventually(lambda: np.isin(boards.positions(), (0, 1)).all())
    client.reset()
    client.move(LEFT, goal="b")
    assert len(client.results("a")) == 1


def test_after_a_fault_planning_starts_from_what_was_measured(client: Observer, boards: Simulation, arm: Arm) -> None:
    """An actuator that is still stuck is detected again, but only if a goal needs it."""
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    aborted(client, "a", label)
    client.wait_now("fault")
    client.reset()
    state = client.wait_now("ready")
    assert state["measured"] == boards.positions().astype(int).tolist()
    assert state["measured"][arm.manipulator.actuators.index(label)] == state_now
    planned = client.ask("plan", waypoints=[{"position": LEFT}])["waypoints"][0]
    assert planned["switches"] == np.count_nonzero(states_at(client, arm, LEFT) != state["measured"])
    loose = time.time()
    boards.fault("release", label)  # its output is still on: it moves, which is reported
    client.wait_fault("unexpected-motion", loose)
    eventually(lambda: np.isin(boards.positions(), (0, 1)).all())
    client.reset()


def test_a_silent_board_is_a_fault_and_when_it_is_heard_again_the_arm_is_ready(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    running(client)
    silenced = time.time()
    boards.fault("silence", "can0/5")
    state = client.wait_fault("board-lost", silenced)
    assert (state["mode"], "can0/5" in state["reason"]) == ("fault", True)
    assert [state is None for state in state["measured"]] == [channel.node == 5 for channel in arm.wiring]
    assert state["tip"] is None
    aborted(client, "a", "can0/5")
    assert client.result("a")["position"] is None
    motions.clear()
    client.ask("reset")
    assert "can0/5" in client.wait_now("fault")["reason"]
    eventually(lambda: refused_for(client, "can0/5"))  # the boards are booted after the reset before it is lost again
    assert motions.still()
    back = time.time()
    boards.fault("unsilence", "can0/5")
    ready_by_itself(client, boards, back)


@pytest.mark.parametrize("which", ["can0/7", "all"])
def test_boards_that_reboot_are_told_and_wait_for_reset(
    client: Observer, boards: Simulation, arm: Arm, which: str
) -> None:
    running(client)
    names = sorted({f"{channel.bus}/{channel.node}" for channel in arm.wiring}) if which == "all" else [which]
    its = np.array([f"{channel.bus}/{channel.node}" in names for channel in arm.wiring])
    before, rebooted = boards.positions(), time.time()
    for board in names:
        boards.fault("power_cut", board)
    for board in names:
        boards.fault("power_on", board)
    client.wait_fault("board-rebooted", rebooted)
    aborted(client, "a", "can0/")
    eventually(lambda: client.codes.count("board-rebooted") == len(names))
    eventually(lambda: not boards.positions()[its].any())
    client.reset()
    after = boards.positions()
    assert not after[its].any(), "reset moved the boards' actuators"
    assert after[~its].tolist() == before[~its].tolist()
    assert client.wait_now("ready")["measured"] == after.astype(int).tolist()
    client.move(RIGHT, goal="after")


def test_an_emergency_is_told_in_words_and_ends_the_goal(client: Observer, boards: Simulation) -> None:
    running(client)
    said = time.time()
    with boards.board("can0/4") as board:
        board.send_message(cia301.EMERGENCY + 4, bytes([0x20, 0x23, 0x80, 0, 0, 0, 0, 0]))
    state = eventually(lambda: next((s for s in client.heard["state"] if s["stamp"] > said and s["faults"]), None))
    assert "output short circuit (2320h)" in state["faults"][0]["message"]
    aborted(client, "a", "can0/4")
    with boards.board("can0/4") as board:
        board.send_message(cia301.EMERGENCY + 4, bytes(8))
    client.reset()
    client.move(RIGHT, goal="after")


@pytest.mark.parametrize(
    ("frame", "named"),
    [
        (Frame(cia301.SYNC), "SYNC, frame 080h"),
        (Frame(cia301.NMT, bytes([Command.START, 5])), "NMT, frame 000h"),
        (cia301.heartbeat(127, State.OPERATIONAL), "the master's heartbeat, frame 77Fh"),
        (Frame(0x205, bytes([7])), "an RPDO, frame 205h"),
    ],
    ids=["SYNC", "NMT", "heartbeat", "RPDO"],
)
def test_another_master_is_told_by_its_frame_and_what_it_latched_switches_nothing(
    client: Observer, boards: Simulation, system: System, frame: Frame, named: str
) -> None:
    running(client)
    before, sent = boards.switches().tolist(), time.time()
    with can.Bus(interface=system.bus.interface, channel=system.bus.channel, ignore_config=True) as other:
        other.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))
    state = client.wait_fault("foreign-master", sent)
    assert named in state["reason"]
    aborted(client, "a", named)
    assert boards.switches().tolist() == before
    client.reset()
    client.move(RIGHT, goal="after")


def starting(system: System, stop: Callable[[Observer], None]) -> None:
    """Starts an arm with one board without power; calls `stop`, then powers the board."""
    system.boards.fault("power_cut", "can0/3")
    system.start_executor()
    system.start_planner()
    with system.client() as client:
        eventually(lambda: client.diagnosed()["executor"] == "connected")
        stop(client)
        assert not system.boards.switches().any()
        client.move(MIDDLE)
        assert [result["id"] for result in client.heard["result"]] == ["move"]


LONG = {"boot_timeout": 120.0 / SLOWNESS}


@pytest.mark.fresh
@pytest.mark.arm(boards=LONG)
def test_a_goal_while_starting_is_refused_with_the_reason(system: System) -> None:
    def refused(client: Observer) -> None:
        client.wait_now("starting")
        answer = client.goal(MIDDLE, id="a")
        assert (answer["accepted"], answer["id"]) == (False, "a")
        assert answer["message"].startswith("the arm is starting: ")
        system.boards.fault("power_on", "can0/3")
        client.wait_now("ready")

    starting(system, refused)


@pytest.mark.fresh
@pytest.mark.arm(boards=LONG)
def test_a_stop_while_starting_stays_until_reset(system: System) -> None:
    def stopped(client: Observer) -> None:
        assert client.ask("stop")["accepted"]
        client.ask("reset")  # the first boot is still under way
        assert client.ask("stop")["accepted"]
        system.boards.fault("power_on", "can0/3")
        client.wait_now("stopped")
        client.reset()

    starting(system, stopped)


@pytest.mark.fresh
@pytest.mark.arm(boards={**QUICK, "boot_timeout": 1.0})
def test_a_missing_board_at_start_is_named_and_may_come_later(system: System) -> None:
    def named(client: Observer) -> None:
        state = client.wait_for("fault", "can0/3")
        assert {fault["code"] for fault in state["faults"]} == {"board-missing"}
        refused = client.goal(MIDDLE)
        assert (refused["accepted"], "can0/3" in refused["message"]) == (False, True)
        system.boards.fault("power_on", "can0/3")
        client.wait_now("ready")  # without a reset: the board's heartbeat starts another boot

    starting(system, named)
