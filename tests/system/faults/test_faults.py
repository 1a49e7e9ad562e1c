"""Boards, actuators, buses and other masters fail: the fault is named, nothing moves, and the arm can recover."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import can
import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.refusals import codes
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.simulation.simulation import Simulation
from tests import emulated, vcan
from tests.system.stack.arms import QUICK
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, first_to_switch, other_place, states_at
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

pytestmark = pytest.mark.arm(boards=QUICK)

Interface = emulated.Interface | vcan.Interface
STALLED = {"halted", "emergency", "board-stopped", "board-lost"}  # faults that a busy machine may add
CONTROLLER, PASSIVE, ACTIVE = 0x04, 0x20, 0x40  # class of an error frame and its details, from linux/can/error.h


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


def ready_by_itself(client: Observer, boards: Simulation, since: float) -> None:
    """Waits until the arm is ready again, still in its measured state, and runs a fresh goal.

    A reset is sent only if a stall of the executor or of the boards has added faults that need one.
    """

    def ready() -> dict | None:
        if client.state["mode"] == "fault" and set(client.codes) & STALLED and not set(client.codes) <= {"board-lost"}:
            client.ask("reset")
        return next((s for s in client.heard["state"] if s["stamp"] > since and s["mode"] == "ready"), None)

    state = eventually(ready)
    assert (client.faults(state), state["goal"]) == ([], None)
    assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
    client.move(RIGHT, goal="after")


def queue_of(system: System) -> Interface:
    """Returns the interface, if it has a queue that can be held."""
    if isinstance(system.interface, vcan.Interface) and (reason := vcan.queueless()):
        pytest.skip(reason)
    return system.interface


def emergency(system: System, data: bytes) -> None:
    with system.boards.board("can0/4") as board:
        board.send_message(cia301.EMERGENCY + 4, data)


def send(frame: Frame, system: System) -> None:
    with can.Bus(interface=system.bus.interface, channel=system.bus.channel, ignore_config=True) as other:
        other.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))


class Case(NamedTuple):
    """A fault in the middle of a goal.

    Attributes:
        words: of its message, of the goal's result, and of refusals.
        end: of its cause.
        resets: whether it needs a reset.
    """

    code: str
    words: str
    begin: Callable[[System], object]
    end: Callable[[System], object] = lambda system: None
    resets: bool = False


MASTERS = {
    "SYNC, frame 080h": Frame(cia301.SYNC),
    "NMT, frame 000h": Frame(cia301.NMT, bytes([Command.START, 5])),
    "the master's heartbeat, frame 77Fh": cia301.heartbeat(127, State.OPERATIONAL),
    "an RPDO, frame 205h": Frame(0x205, bytes([7])),
}
CASES = {
    "interface down": Case("bus-down", "can0", lambda s: s.interface.down(), lambda s: s.interface.up()),
    "interface deleted": Case("bus-down", "can0", lambda s: s.interface.delete(), lambda s: s.interface.make()),
    "queue full": Case("bus-busy", "can0", lambda s: queue_of(s).hold(), lambda s: s.interface.release()),
    "emergency": Case(
        "emergency",
        "output short circuit (2320h)",
        lambda s: emergency(s, bytes([0x20, 0x23, 0x80, 0, 0, 0, 0, 0])),
        lambda s: emergency(s, bytes(8)),
        resets=True,
    ),
    **{name: Case("foreign-master", name, partial(send, frame), resets=True) for name, frame in MASTERS.items()},
}


@pytest.mark.parametrize("name", CASES)
def test_a_fault_is_told_ends_the_goal_once_and_switches_nothing(client: Observer, system: System, name: str) -> None:
    case = CASES[name]
    running(client)
    switches, since = system.boards.switches().tolist(), time.time()
    case.begin(system)
    state = client.wait_fault(case.code, since)
    assert (state["mode"], case.words in str(state["faults"])) == ("fault", True), state
    aborted(client, "a", "can0/4" if name == "emergency" else case.words)
    eventually(lambda: client.state["goal"] is None)
    assert system.boards.switches().tolist() == switches
    if not case.resets:
        assert refused_for(client, case.words)
    back = time.time()
    case.end(system)
    if case.resets:
        client.reset()
    ready_by_itself(client, system.boards, back)


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
    for what in ("power_cut", "power_on"):
        for board in names:
            boards.fault(what, board)
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


def test_a_stuck_actuator_is_named_its_goal_aborted_once_and_planning_starts_from_what_was_measured(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    """An actuator that is still stuck is detected again, but only if a goal needs it."""
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    aborted(client, "a", label)
    state = client.wait_now("fault")
    assert (label in state["reason"], [fault["code"] for fault in state["faults"]]) == (True, ["stuck"])
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
    client.move(LEFT, goal="b")
    assert len(client.results("a")) == 1


@pytest.mark.parametrize("off", [True, False], ids=["bus-off", "a full queue"])
def test_what_was_queued_at_a_fault_of_the_bus_switches_nothing(client: Observer, system: System, off: bool) -> None:
    client.move(MIDDLE, goal="before")
    goal, since = other_place(client, system.arm), time.time()
    queue_of(system).hold()  # the goal's frames are in the queue; ten frames later sending fails with ENOBUFS
    assert client.goal(goal, id="a")["accepted"]
    if off:
        system.interface.bus_off()
    assert client.wait_fault("bus-off" if off else "bus-busy", since)["mode"] == "fault"
    aborted(client, "a", "can0")
    assert client.wait_now("fault")["goal"] is None
    before, back = system.boards.switches().tolist(), time.time()
    if off:
        assert client.result("a")["switches"] == 0
        system.interface.restart()
    else:
        system.interface.release()
    ready_by_itself(client, system.boards, back)
    assert not off or system.boards.switches().tolist() != before, "by the goal after it"


def test_error_passive_is_told_and_the_arm_goes_on(interface: Interface, client: Observer) -> None:
    passive = time.time()
    interface.tell(CONTROLLER, PASSIVE, tx_errors=130, rx_errors=7)
    state = client.wait_fault("bus-passive", passive)
    assert (state["mode"], "130 transmit" in state["faults"][0]["message"]) == ("ready", True)

    def diagnosed() -> bool:
        buses = [it["buses"][0] for it in client.heard["diagnostics"] if it["buses"]]
        return any((bus["state"], bus["tx_errors"], bus["rx_errors"]) == ("passive", 130, 7) for bus in buses)

    eventually(diagnosed)
    client.move(RIGHT)
    interface.tell(CONTROLLER, ACTIVE)
    eventually(lambda: not client.codes)


@pytest.mark.arm(boards={"settle_margin": 10.0})
def test_a_bus_full_of_others_frames_does_not_stop_the_arm(
    interface: Interface, client: Observer, system: System
) -> None:
    """Frames of low priority, so that ours are still sent."""
    bitrate, load = (250_000, 0.05) if SLOWNESS == 1 else (20_000, 0.005)  # as many frames as the machine can read
    if isinstance(interface, vcan.Interface) and not vcan.queueless():
        interface.bound(bitrate)
    ending, every = threading.Event(), 0.01 * SLOWNESS
    frames = round(bitrate / 135 * every)  # one of 8 bytes has up to 135 bits
    busy = can.Message(arbitration_id=0x7E0, data=bytes(8), is_extended_id=False)

    def flood() -> None:
        with can.Bus(interface=system.bus.interface, channel=system.bus.channel, ignore_config=True) as other:
            vcan.give_way(other, vcan.LAST)
            while not ending.wait(every):
                with suppress(can.CanOperationError):  # the queue is full, as intended
                    for _ in range(frames):
                        other.send(busy)

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        for k in range(4):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
        eventually(lambda: any(it["buses"][0]["load"] > load for it in client.heard["diagnostics"] if it["buses"]))
    finally:
        ending.set()
        flooding.join()
    assert client.faults(client.wait_now("ready")) == []


@pytest.mark.arm(boards={**QUICK, "boot_timeout": 1.0})
@pytest.mark.fresh
def test_a_board_without_power_at_the_start_is_a_fault_until_it_is_heard(system: System) -> None:
    system.boards.fault("power_cut", "can0/3")
    system.start_executor()
    system.start_planner()
    with system.client() as client:
        state = client.wait_for("fault", "can0/3")
        assert {fault["code"] for fault in state["faults"]} == {"board-missing"}
        assert refused_for(client, "can0/3")
        system.boards.fault("power_on", "can0/3")
        client.wait_now("ready")  # without a reset: the board's heartbeat starts another boot
        assert not system.boards.switches().any()
        client.move(MIDDLE)
        assert [result["id"] for result in client.heard["result"]] == ["move"]
