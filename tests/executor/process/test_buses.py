"""Buses of the event loop: CAN interfaces, and simulated boards that live in real time."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any

import can
import pytest

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ExecutorTick, FromClient, SendFrame, ToClient
from hyperbit.controller.executor.process.buses import OPEN_EVERY, CanBuses
from hyperbit.controller.executor.process.embedded_boards import EmbeddedBoards, simulated_boards
from hyperbit.controller.program import TICK, VERSION, Alive, Ended, Hello, Program, Snapshot, Stage, pack
from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire.bus import CanBus, InterfaceInUse
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import BusWiring
from tests.executor.rig import PLANNER, SIZE, small_arm

CHANNEL = "test_listening"


def beat(state: int = 5) -> can.Message:
    return can.Message(arbitration_id=0x77F, data=[state], is_extended_id=False)


@pytest.fixture
def other() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        yield bus


@pytest.fixture
def buses() -> Iterator[CanBuses]:
    buses = CanBuses([BusWiring("can0", "virtual", CHANNEL)])
    yield buses
    buses.close()


def test_a_second_master_on_a_bus_is_refused(buses: CanBuses, other: can.BusABC) -> None:
    over = threading.Event()

    def beats() -> None:
        while not over.wait(0.05):
            other.send(beat())

    thread = threading.Thread(target=beats)
    thread.start()
    try:
        with pytest.raises(BusError, match="can0: another executor is on this bus"):
            buses.listen(0.0, least=60.0)
    finally:
        over.set()
        thread.join()
    assert other.recv(0) is None, "it has sent nothing"


def test_heartbeats_that_the_kernel_kept_of_a_dead_executor_come_at_once_and_do_not_count(
    buses: CanBuses, other: can.BusABC
) -> None:
    for _ in range(5):
        other.send(beat())
    buses.listen(0.0, least=0.05, apart=60.0)
    assert isinstance(buses.poll(0.0)[0], BusChanged)
    assert other.recv(0) is None
    other.send(beat(0x7F))  # a board with the node id 127 is no master
    buses.listen(0.0, least=0.05, apart=-1.0)


def test_why_a_bus_cannot_be_opened_is_told_when_it_is_new(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    used = InterfaceInUse("process 7 of hyperbit uses can0: stop it first")
    errors = [*[BusError("can0: no such interface")] * 3, *[used] * 4]

    def fail(bus: CanBus) -> None:
        raise errors.pop(0)

    monkeypatch.setattr(CanBus, "open", fail)
    buses = CanBuses([BusWiring("can0", "virtual", "none")])
    with caplog.at_level(logging.ERROR):
        for k in range(6):
            buses.poll(1.0 + k * OPEN_EVERY)
    assert [record.getMessage() for record in caplog.records] == [
        "can0: no such interface; tried again every 1 s",
        "process 7 of hyperbit uses can0: stop it first; tried again every 1 s",
    ]
    with pytest.raises(InterfaceInUse):  # at the start
        CanBuses([BusWiring("can0", "virtual", "none")]).poll(1.0)


class Loop:
    """An event loop with simulated boards, on a clock of the test, which can stand still."""

    def __init__(self, **fields: Any) -> None:
        self.arm, self.now = small_arm(**fields), 50.0
        self.boards: EmbeddedBoards = simulated_boards(self.arm, [])
        self.snapshots: list[Snapshot] = []
        self.ended: list[Ended] = []
        self._core = Executor(self.arm, SwitchJournal(SIZE), instance=1)
        self.do(FromClient(PLANNER, Hello(VERSION, "planner", "small")))
        self.run(3.0)
        assert self.mode == "ready", self.snapshots[-1].reason

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.stall(TICK)

    def stall(self, seconds: float) -> None:
        """Stands still, then reads the frames, then ticks."""
        self.now += seconds
        self._poll()
        self.do(FromClient(PLANNER, Alive()))
        self.do(ExecutorTick())
        self._poll()

    def _poll(self) -> None:
        for event in self.boards.poll(self.now):
            self.do(event)

    @property
    def mode(self) -> str:
        return self.snapshots[-1].mode

    @property
    def faults(self) -> set[str]:
        return {fault.code for snapshot in self.snapshots for fault in snapshot.faults}

    def do(self, event: Any) -> None:
        for action in self._core.step(event, self.now):
            match action:
                case SendFrame():
                    self.boards.send_frame(action.bus, action.frame, self.now)
                case ToClient(message=Snapshot()):
                    self.snapshots.append(action.message)
                case ToClient(message=Ended()):
                    self.ended.append(action.message)


def test_a_silent_board_is_lost_after_the_timeout_of_the_arms_file() -> None:
    loop = Loop()
    timeout = loop.arm.timing.heartbeat_timeout
    loop.boards.play_fault("silence can0/1")
    loop.run(timeout / 2)
    assert loop.mode == "ready"
    loop.run(timeout / 2 + 10 * TICK)
    assert (loop.mode, loop.faults) == ("fault", {"board-lost"})


def test_a_stall_that_the_boards_bear_is_no_fault_and_in_a_longer_one_they_lose_their_master() -> None:
    loop = Loop()
    for share in (0.2, 0.6, 0.2, 0.6):
        loop.stall(share * loop.arm.timing.heartbeat_timeout)
        loop.run(0.3)
    assert (loop.mode, loop.faults) == ("ready", set())
    loop.stall(20.0)
    loop.run(1.0)
    assert loop.mode == "fault"
    assert "halted" in loop.faults
    assert "board-lost" not in loop.faults, "the master loses no board"


def test_after_bus_off_the_arm_recovers_by_itself() -> None:
    loop = Loop()
    loop.boards.play_fault("bus_off can0")
    loop.run(5.0)
    assert (loop.mode, "bus-off" in loop.faults) == ("fault", True)
    loop.boards.play_fault("bus_on can0")
    loop.run(20.0)
    assert loop.mode == "ready", loop.snapshots[-1].reason


@pytest.mark.parametrize("lateness", [0.0, 0.017, 0.15])
def test_boards_inside_an_executor_that_stalls_give_their_own_times(lateness: float) -> None:
    loop = Loop(channel={"input_contracted": True, "travel": (0.16, 0.24)})
    ready = loop.snapshots[-1]
    stages = (Stage(pack(1, SIZE), at=0.0, mark=0),)
    loop.do(FromClient(PLANNER, Program(1, ready.epoch, ready.outputs, 0.0, stages, True, False, "goal")))
    for k in range(300):
        loop.stall(0.003 if k % 10 else 0.003 + lateness)
    [ended] = loop.ended
    assert [(t.actuator, t.state, t.seconds) for t in ended.travels] == [(0, 1, pytest.approx(0.12, rel=0.1))]
