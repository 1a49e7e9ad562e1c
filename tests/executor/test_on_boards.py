"""The executor on the real CANopen master and simulated boards, on a simulated clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import pytest

from controller.executor.core import PERIOD, Executor
from controller.executor.events import Client, FromClient, Log, Quit, Send, Tick, ToClient
from controller.executor.switch_journal import MemoryJournal
from controller.program import (
    Accepted,
    Alive,
    Begun,
    Diagnostics,
    Ended,
    Halt,
    Hello,
    Program,
    Reset,
    Settled,
    Snapshot,
    Stage,
    pack,
    unpack,
)
from drivers.canopen.wire.events import Changed, Echoed, Received
from drivers.simulation.buses import SimulatedBuses
from drivers.simulation.fault_commands import perform
from drivers.simulation.variants import Variant
from tests.executor.rig import SIZE, TRAVEL, small_arm

A, B = 0b000111, 0b011100
PLANNER = Client(1, 4001)
STEP = 0.001  # [s]


class World:
    """Executor, boards and planner; time passes in milliseconds."""

    def __init__(self, variants: Mapping[str, Variant] | None = None, **fields: Any) -> None:
        self.now = 50.0
        arm = small_arm(**fields)
        self.core = Executor(arm, journal := MemoryJournal(SIZE), instance=1)
        self.journal = journal
        self.events: deque[Any] = deque(Changed(bus.name, "active", "", None) for bus in arm.wiring.buses)
        self.boards = SimulatedBuses(
            arm.wiring, arm.timing, lambda bus, frame: self.events.append(Received(bus, frame)), variants
        )
        self.heard: list[tuple[float, Any]] = []
        self.syncs: list[float] = []
        self.logged: list[str] = []
        self._ticks = 0
        self.cut = False  # the bus carries no frame
        self._do(FromClient(PLANNER, Hello(1, "planner", "small")))

    def _do(self, event: Any) -> None:
        self.events.append(event)
        self._take_events()

    def _take_events(self) -> None:
        while self.events:
            event = self.events.popleft()
            if self.cut and isinstance(event, Received):
                continue
            for action in self.core.step(event, self.now):
                match action:
                    case Send() if self.cut:
                        pass
                    case Send():
                        if action.frame.id == 0x80:
                            self.syncs.append(self.now)
                        self.events.append(Echoed(action.bus, action.frame))
                        self.boards.receive(action.bus, action.frame, self.now)
                    case ToClient():
                        self.heard.append((self.now, action.message))
                    case Log():
                        self.logged.append(action.text)

    def send(self, message: Any) -> None:
        self._do(FromClient(PLANNER, message))

    def go(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            self.boards.step(self.now)
            self._ticks += 1
            if self._ticks % round(PERIOD / STEP) == 0:
                self.send(Alive())
                self._do(Tick())
            self._take_events()

    def stall(self, seconds: float, *fault: str) -> None:
        """Advances the boards, with a fault, while the executor does not run."""
        begun = self.now
        while self.now < begun + seconds:
            self.now += STEP
            self.boards.step(self.now)
            if fault and self.now > begun + seconds / 2:
                perform(self.boards, *fault)
                fault = ()

    def run(self, number: int, *states: int, step: float = 0.2) -> None:
        snapshot = self.last(Snapshot)
        stages = tuple(Stage(pack(bits, SIZE), at=step * k, mark=k) for k, bits in enumerate(states))
        self.send(Program(number, snapshot.epoch, snapshot.outputs, 0.0, stages, True, False, f"goal {number}"))

    def of(self, kind: type) -> list[Any]:
        return [message for _, message in self.heard if isinstance(message, kind)]

    def last(self, kind: type) -> Any:
        return self.of(kind)[-1]

    @property
    def mode(self) -> str:
        return self.core.modes.mode


@pytest.fixture
def world() -> World:
    world = World()
    world.go(2.0)
    assert world.mode == "ready", world.logged
    return world


def test_a_program_moves_the_actuators_and_its_sync_leaves_with_its_message(world: World) -> None:
    world.run(1, A, B)
    assert world.syncs == [world.now], "without waiting for a tick"
    assert world.of(Accepted)
    world.go(0.6)
    assert [(m.mark, m.switches, unpack(m.measured)) for m in world.of(Settled)] == [(0, 3, A), (1, 7, B)]
    assert [m.stage for m in world.of(Begun)] == [0, 1]
    assert world.last(Ended).status == "done"
    assert world.boards.drives() == [B >> k & 1 for k in range(SIZE)]
    assert world.journal.counts == world.boards.switches()


def test_an_actuator_that_sticks_is_found_and_reset_goes_on_with_it_released(world: World) -> None:
    perform(world.boards, "stick", "1.left", 0)
    world.run(1, A)
    world.go(0.3)
    assert (world.mode, world.last(Ended).status) == ("fault", "aborted")
    assert [fault.code for fault in world.last(Snapshot).faults] == ["stuck"]
    perform(world.boards, "release", "1.left")
    world.go(0.5)
    world.send(Reset(1))
    world.go(2.0)
    assert world.mode == "ready", world.logged
    world.run(2, 0)
    world.go(0.3)
    assert world.last(Ended).status == "done"
    assert world.journal.counts == world.boards.switches()


def test_one_toggled_at_every_transition_that_sticks_is_found(world: World) -> None:
    perform(world.boards, "stick", "1.left", 0)
    number = 0
    while world.mode != "fault" and number < 30:
        number += 1
        world.run(number, unpack(world.last(Snapshot).outputs) ^ 1)
        world.go(TRAVEL + PERIOD)
    assert number < 10
    assert "missed 3 commands" in world.core.modes.reason


def test_the_fault_of_a_lost_board_clears_when_the_board_is_back(world: World) -> None:
    world.run(1, A, B, step=5.0)
    world.go(0.1)
    world.boards.silence("can0/2")
    world.go(1.0)
    assert (world.mode, world.last(Ended).status) == ("fault", "aborted")
    world.boards.unsilence("can0/2")
    world.go(4.0)
    assert world.mode == "ready", world.logged
    assert world.last(Snapshot).faults == ()
    world.go(1.0)
    assert len(world.syncs) == 1, "nothing moves by itself"


def test_a_halted_executor_lets_the_boards_hold_and_acts_on_nothing_old(world: World) -> None:
    world.run(1, A, B, step=1.0)
    world.go(0.1)
    world.now += 3.0
    world.run(2, B)
    world.go(0.1)
    assert (world.mode, len(world.syncs)) == ("fault", 1)


@pytest.mark.parametrize("code", ["8130", "2320", "8120"])
def test_frames_that_waited_during_a_stall_are_no_fault_after_a_reset(world: World, code: str) -> None:
    world.stall(3.0, "error", "can0/1", code)
    world.boards.step(world.now)
    perform(world.boards, "error_over", "can0/1", code)
    waiting = list(world.events)
    world.events.clear()
    world.send(Reset(1))
    world.events.extend(waiting)
    world.go(1.0)
    assert world.mode == "ready", world.logged
    assert world.last(Snapshot).faults == ()


def test_halt_and_end(world: World) -> None:
    world.run(1, A, B)
    world.send(Halt(1))
    assert world.mode == "stopped"
    world._do(Quit())
    assert world.core.ended
    assert len(world.of(Ended)) == 1


def test_diagnostics_tell_of_buses_and_boards(world: World) -> None:
    world.go(1.1)
    diagnostics = world.last(Diagnostics)
    assert [bus["name"] for bus in diagnostics.buses] == ["can0"]
    assert {board["state"] for board in diagnostics.boards} == {"operational"}


@pytest.mark.parametrize("sensed", [0, 0b111111])
def test_a_restarted_executor_adopts_the_present_states(sensed: int) -> None:
    world = World(sensed=sensed)
    world.go(2.0)
    world.run(1, A)
    world.go(0.2)
    again = World.__new__(World)
    again.__dict__ |= {**world.__dict__, "heard": [], "syncs": [], "_ticks": 0}
    again.core = Executor(small_arm(sensed), world.journal, instance=2)
    again.events = deque([Changed("can0", "active", "", None)])
    world.boards._take = lambda bus, frame: again.events.append(Received(bus, frame))
    again._do(FromClient(PLANNER, Hello(1, "planner", "small")))
    again.go(2.0)
    assert again.mode == "ready", again.logged
    assert unpack(again.last(Snapshot).outputs) == A
    assert again.syncs == []
