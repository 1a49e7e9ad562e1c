"""Boards inside the executor's process: they live in real time, with the times of the arm's file."""

from __future__ import annotations

from typing import Any

import pytest

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ExecutorTick, FromClient, SendFrame, ToClient
from hyperbit.controller.executor.process.embedded_boards import EmbeddedBoards, simulated_boards
from hyperbit.controller.program import TICK, VERSION, Alive, Hello, Snapshot
from tests.executor.rig import PLANNER, SIZE, small_arm


class Loop:
    """An event loop on a clock of the test, which can stand still."""

    def __init__(self) -> None:
        self.arm, self.now = small_arm(), 50.0
        self.boards: EmbeddedBoards = simulated_boards(self.arm, [])
        self.snapshots: list[Snapshot] = []
        self._core = Executor(self.arm, SwitchJournal(SIZE), instance=1)
        self._do(FromClient(PLANNER, Hello(VERSION, "planner", "small")))
        self.run(3.0)
        assert self.snapshots[-1].mode == "ready", self.snapshots[-1].reason

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.stall(TICK)

    def stall(self, seconds: float) -> None:
        """Stands still, then reads the frames, then ticks."""
        self.now += seconds
        for event in self.boards.poll(self.now):
            self._do(event)
        self._do(FromClient(PLANNER, Alive()))
        self._do(ExecutorTick())
        for event in self.boards.poll(self.now):
            self._do(event)

    @property
    def faults(self) -> set[str]:
        return {fault.code for snapshot in self.snapshots for fault in snapshot.faults}

    def _do(self, event: Any) -> None:
        for action in self._core.step(event, self.now):
            if isinstance(action, SendFrame):
                self.boards.send_frame(action.bus, action.frame, self.now)
            elif isinstance(action, ToClient) and isinstance(action.message, Snapshot):
                self.snapshots.append(action.message)


def test_a_silent_board_is_lost_after_the_timeout_of_the_arms_file() -> None:
    loop = Loop()
    timeout = loop.arm.timing.heartbeat_timeout
    loop.boards._boards.silence("can0/1")
    loop.run(timeout / 2)
    assert loop.snapshots[-1].mode == "ready"
    loop.run(timeout / 2 + 10 * TICK)
    assert (loop.snapshots[-1].mode, loop.faults) == ("fault", {"board-lost"})


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_a_stall_that_the_boards_bear_is_no_fault(share: float) -> None:
    loop = Loop()
    for _ in range(5):
        loop.stall(share * loop.arm.timing.heartbeat_timeout)
        loop.run(0.3)
    assert (loop.snapshots[-1].mode, loop.faults) == ("ready", set())


@pytest.mark.parametrize("stall", [1.0, 20.0])
def test_boards_lose_a_master_that_stands_still_but_the_master_loses_no_board(stall: float) -> None:
    loop = Loop()
    loop.stall(stall)
    loop.run(1.0)
    assert loop.snapshots[-1].mode == "fault"
    assert "halted" in loop.faults
    assert "board-lost" not in loop.faults


def test_after_bus_off_the_arm_recovers_by_itself() -> None:
    loop = Loop()
    loop.boards.play_fault("bus_off can0")
    loop.run(5.0)
    assert loop.snapshots[-1].mode == "fault"
    assert "bus-off" in loop.faults
    loop.boards.play_fault("bus_on can0")
    loop.run(20.0)
    assert loop.snapshots[-1].mode == "ready", loop.snapshots[-1].reason
