"""Stops at each moment of a commit, with the real CANopen master, simulated boards, and frames that leave late."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import pytest

from controller.executor.core import PERIOD
from controller.executor.events import ClientGone, FromClient, Log, Quit, Send, Tick, ToClient
from controller.program import Alive, Answer, Cancel, Ended, Halt, Hello, Reset, Snapshot, unpack
from drivers.canopen.wire import cia301
from drivers.canopen.wire.events import Echoed
from drivers.canopen.wiring import Interlock
from drivers.simulation.fault_commands import perform
from drivers.simulation.variants import VARIANTS
from tests.executor.rig import SIZE
from tests.executor.test_on_boards import PLANNER, STEP, A, World

C = 0b111000
EACH = 0.007  # [s] for which each frame keeps the bus of the slow world busy
DOOR = Interlock("door", "can0", 9, 0)
BOARDS = {
    "SYNC": {},
    "no SYNC": {"variants": {"can0/1": VARIANTS["no-sync"], "can0/2": VARIANTS["no-sync"]}},
    "one without SYNC": {"variants": {"can0/2": VARIANTS["no-sync"]}},
    "pulses": {"channel": {"output_off": True, "pulse": 0.05}},
}
FRAMES = 4  # more than any commit here has: two RPDOs and SYNC


class SlowWorld(World):
    """A world whose bus sends frame after frame; each leaves EACH seconds after the one before it.

    Attributes:
        slow: whether frames wait; otherwise they leave at once.
    """

    def __init__(self, **fields: Any) -> None:
        self.slow = False
        self.line: deque[Send] = deque()
        self._free_at = 0.0
        super().__init__(**fields)

    def _do(self, event: Any) -> None:
        self.events.append(event)
        while self.events:
            for action in self.core.step(self.events.popleft(), self.now):
                match action:
                    case Send():
                        self.line.append(action)
                        if not self.slow:
                            self.leave()
                    case ToClient():
                        self.heard.append((self.now, action.message))
                    case Log():
                        self.logged.append(action.text)

    def leave(self) -> None:
        """Sends the first frame of the line."""
        _, frame = action = self.line.popleft()
        if frame.id == cia301.SYNC:
            self.syncs.append(self.now)
        self.boards.receive(action.bus, frame, self.now)
        self.events.append(Echoed(action.bus, frame))

    def handle(self) -> None:
        """Handles the events that wait."""
        while self.events:
            self._do(self.events.popleft())

    def go(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            self.boards.step(self.now)
            if self.line and self.now >= self._free_at:
                self.leave()
                self._free_at = self.now + EACH
            self._ticks += 1
            if self._ticks % round(PERIOD / STEP) == 0:
                if self.core._clients.planner is not None:
                    self.send(Alive())
                self._do(Tick())
            self.handle()
            each()

    def greet(self) -> None:
        """Connects the planner again if it is gone."""
        if self.core._clients.planner is None:
            self._do(FromClient(PLANNER, Hello(1, "planner", "small")))

    def fast(self) -> None:
        """Sends all frames that wait, and later ones at once."""
        self.slow = False
        while self.line or self.events:
            while self.line:
                self.leave()
            self.handle()

    @property
    def driven(self) -> int:
        """States to which the valves drive the actuators."""
        return sum(end << k for k, end in enumerate(self.boards.drives()))

    def commanded(self, boards: str) -> int:
        """Number of switches; a pulsed actuator follows its coil late, so there the executor's count is taken."""
        return sum(self.journal.counts) if boards == "pulses" else sum(self.boards.switches())


def committing(boards: str, sent: int) -> tuple[SlowWorld, int]:
    """Returns a world at A in the middle of its commit of C, after `sent` frames, and its switches before."""
    world = SlowWorld(interlocks=(DOOR,), **BOARDS[boards])
    world.go(2.0)
    assert world.mode == "ready", world.logged
    world.run(1, A)
    world.go(0.6)
    assert (world.last(Ended).status, world.driven) == ("done", A), world.logged
    world.slow = True
    before = sum(world.boards.switches())
    world.run(2, C)
    for _ in range(sent):
        if world.line:
            world.leave()
            world.handle()
    world.now += STEP  # simulated actuators follow their coils with the next step
    world.boards.step(world.now)
    return world, before


def finish(world: SlowWorld) -> None:
    """A later goal works, and each switch was counted once."""
    world.fast()
    world.greet()
    perform(world.boards, "close", "door")
    perform(world.boards, "error_over", "can0/1", "2320")
    world.go(1.0)
    if world.mode in ("fault", "stopped"):
        world.send(Reset(99))
    world.go(2.0)
    assert world.mode == "ready", world.logged
    stops = world.driven
    assert stops == unpack(world.last(Snapshot).outputs)
    world.run(3, stops ^ 0b100001)
    world.go(0.6)
    assert (world.last(Ended).status, world.driven) == ("done", stops ^ 0b100001), world.logged
    assert world.journal.counts == world.boards.switches()


REQUESTS = {"stop": Halt(9), "cancel": Cancel(9, None, "")}


@pytest.mark.parametrize("sent", range(FRAMES))
@pytest.mark.parametrize("boards", BOARDS)
@pytest.mark.parametrize("request_", REQUESTS)
def test_nothing_switches_after_the_answer(request_: str, boards: str, sent: int) -> None:
    world, before = committing(boards, sent)
    asked, given = world.now, world.commanded(boards)
    world.send(REQUESTS[request_])
    assert world.mode == {"stop": "stopped", "cancel": "ready"}[request_], "at once"
    world.handle()
    answered: list[int] = []
    coils: list[set[tuple[int, int]]] = []

    def watch() -> None:
        if any(isinstance(message, Answer) and world.now > at for at, message in world.heard):
            answered.append(world.commanded(boards))
            coils.append({(k, side) for k, pair in enumerate(world.boards.coils()) for side in (0, 1) if pair[side]})

    world.go(0.5, watch)
    ((at, answer),) = [(at, message) for at, message in world.heard if isinstance(message, Answer)]
    assert set(answered) == {answered[0]}
    assert all(later <= coils[0] for later in coils), "a pulse may end, and none may begin"
    assert at - asked <= world.core._arm.timing.heartbeat_timeout / 2
    told = answered[0] - given
    expected = {0: "", 3: "; 3 switches were under way", 6: "; 6 switches were under way"}[told]
    holds = "; the arm holds until reset" if request_ == "stop" else ""
    assert answer.message == f"{'stopped' if request_ == 'stop' else 'canceled'}{expected}{holds}"
    assert world.of(Ended)[1].switches == answered[0] - before
    finish(world)


@pytest.mark.parametrize("sent", range(FRAMES))
@pytest.mark.parametrize("boards", BOARDS)
@pytest.mark.parametrize("cause", ["fault", "interlock", "planner gone", "planner silent", "end"])
def test_an_end_without_a_request_gives_up_the_frames_that_wait(cause: str, boards: str, sent: int) -> None:
    world, before = committing(boards, sent)
    syncs = len(world.syncs)
    match cause:
        case "fault":
            perform(world.boards, "error", "can0/1", "2320")
        case "interlock":
            perform(world.boards, "open", "door")
        case "planner gone":
            world._do(ClientGone(PLANNER))
        case "planner silent":
            world.core._lose_planner("the planner is silent")
        case "end":
            world._do(Quit())
    world.boards.step(world.now)
    world.handle()
    assert world.mode == ("fault" if cause in ("fault", "interlock") else "ready"), "at once"
    handed_out = any(send.frame.id == cia301.SYNC for send in world.line)
    world.go(0.5)
    world.greet()
    ended = next(ended for ended in world.of(Ended) if ended.program == 2)
    assert ended.status == ("done" if ended.switches == 6 and not handed_out and sent > 3 else "aborted")
    if boards in ("SYNC", "pulses"):
        moved = 6 if sent >= 2 else 0
        assert (sum(world.boards.switches()) - before, ended.switches) == (moved, moved)
    else:
        assert ended.switches == sum(world.boards.switches()) - before
    if not handed_out and boards != "pulses":  # the end of a pulse needs a SYNC, which moves nothing
        assert len(world.syncs) == syncs
    if cause == "end":
        assert world.core.ended
    else:
        finish(world)


@pytest.mark.parametrize("late", [k * STEP for k in range(0, 40, 3)])
def test_a_pulse_that_ends_moves_nothing_of_what_boards_have_latched(late: float) -> None:
    """The SYNC that ends a pulse comes while boards still hold frames of a commit that was given up."""
    world = SlowWorld(**BOARDS["pulses"])
    world.go(2.0)
    world.run(1, A)
    world.go(0.6)
    world.run(2, A ^ 1, A ^ 1 ^ C, step=late)
    world.go(late)
    world.slow = True
    world.send(Halt(9))
    world.handle()
    world.go(0.1)
    driven = world.driven
    world.go(0.5)
    assert world.driven == driven
    assert world.boards.coils() == [(0, 0)] * SIZE
    finish_pulses(world)


def finish_pulses(world: SlowWorld) -> None:
    """A later goal works, and each switch was counted once."""
    world.fast()
    world.send(Reset(99))
    world.go(2.0)
    world.run(3, unpack(world.last(Snapshot).outputs) ^ 0b100001)
    world.go(0.6)
    assert world.last(Ended).status == "done", world.logged
    assert world.journal.counts == world.boards.switches()
