"""The executor in its simulated world; the invariants must find planted defects."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.executor.arm.kinds import Kinds
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.modes import Modes
from hyperbit.controller.executor.motion.actuation import Actuation, Readings
from hyperbit.controller.executor.motion.program_execution import STARVED, End, ProgramExecution, ProgramResults
from hyperbit.controller.program import Replacement
from hyperbit.drivers.canopen.run.commit import BusCommit
from hyperbit.drivers.canopen.run.heartbeat import Heartbeat
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from tests.simulation.judge.verdict import Violation
from tests.simulation.world import World

ROOT = Path(__file__).parents[2]
STEPS = 3_000


@pytest.mark.parametrize("seed", range(8))
def test_invariants_hold(seed: int) -> None:
    World(seed).run(STEPS)


# In a process of its own: in this one, timers of other threads would never come.
REPLAY = f"""
import time
from tests.simulation.world import World

jumps = iter(range(0, 10**9, 997))
for clock in ("time", "monotonic", "time_ns", "monotonic_ns"):
    setattr(time, clock, lambda: next(jumps))
world = World(3, remembered=10**6)
world.run({STEPS})
print(world.story())
"""


def test_a_seed_replays_exactly_and_whatever_the_clock_of_the_system_says() -> None:
    world = World(3, remembered=10**6)
    world.run(STEPS)
    replay = subprocess.run([sys.executable, "-c", REPLAY], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    assert replay.stdout == f"{world.story()}\n"


def _count_everything(self: SwitchJournal, states: int, unknown: int = 0) -> int:
    for k in range(len(self.counts)):
        self.counts[k] += self._intended >> k & 1
    self._intended = 0
    return 0


_begin = BusCommit.begin


def _do_not_wait(self: BusCommit, *arguments: Any) -> None:
    _begin(self, *arguments)
    self.waiting = {}


_hold_measured = Modes.hold_measured


def _energise(self: Modes, now: float) -> None:
    _hold_measured(self, now)
    actuation = self._motion.actuation
    actuation.switch(actuation.states, now, homing=-1)


class _Kept(dict[int, Any]):
    def pop(self, *_: object) -> None:
        """Removes nothing."""


_begin_results = ProgramResults.__init__


def _keep_results(self: ProgramResults, send: Any, journal: SwitchJournal) -> None:
    _begin_results(self, send, journal)
    self.stored = _Kept()


_enter = SimulatedBoard.enter


def _start_switches(self: SimulatedBoard, state: State) -> None:
    before = self.state
    _enter(self, state)
    if state is State.OPERATIONAL and before is not state:
        for wired in self.wired:
            sub = wired.output // 8 + 1
            index = self.variant.output_object
            self.objects.set_number(index, sub, self.objects.number(index, sub) ^ 1 << wired.output % 8)
        self.drive()


_give_up = BusCommit.give_up


def _give_up_late(self: BusCommit, why: str) -> None:
    if "not sent" in why or "lost" in why:
        _give_up(self, why)


_replace = ProgramExecution.replace


def _settle_again(self: ProgramExecution, message: Replacement, most: int, actuators: int) -> None:
    _replace(self, message, most, actuators)
    if self.mark >= 0 and self._stages[self.taken].mark >= 0:
        self._settles = 0.0


def _take_again(self: ProgramExecution, message: Replacement, most: int, actuators: int) -> None:
    _replace(self, message, most, actuators)
    self.taken = max(-1, min(self.taken, message.first - 2))


def _wait_for_ever(self: ProgramExecution, clock: float) -> End | None:
    return End("done", "", "") if self.final else None


def _do_not_wait_for_stages(self: ProgramExecution, clock: float) -> End | None:
    return End("done", "", "") if self.final else End("aborted", STARVED, "")


def _begin_no_epoch(self: Executor, why: str) -> None:
    if not self.ending.begun:
        self.modes.hold("aborted", f"{why}; the arm holds", f"holding; {why}")


def _go_on(self: Modes, status: str, message: str, reason: str, mode: Any = "ready") -> None:
    if mode != "ready" or self.mode == "executing":
        self.enter(mode, reason)


DEFECTS: dict[str, tuple[type, str, Callable[..., Any]]] = {
    "stages wait neither for those before nor for a rest": (Actuation, "ready_at", lambda self, states, strict: 0.0),
    "switches are counted that were not made": (SwitchJournal, "resolve", _count_everything),
    "results are sent again for ever": (ProgramResults, "__init__", _keep_results),
    "a program goes on after cancel and halt": (Modes, "hold", _go_on),
    "stages begin too early": (ProgramExecution, "due", lambda self, now, *_: self.taken + 1 if self._stages else None),
    "locks are taken whatever the end-stops read": (LockedActuators, "refusal", lambda self, *_: None),
    "heartbeats end": (Heartbeat, "tick", lambda self, clock, now: None),
    "the SYNC does not wait for the RPDOs": (BusCommit, "begin", _do_not_wait),
    "no epoch ends": (Modes, "new_epoch", lambda self: None),
    "pulses do not end": (Actuation, "tick", lambda self, now: None),
    "both outputs of a pair are on": (Kinds, "_off_lines", lambda self, mask: mask << self._size),
    "a start energises": (Modes, "hold_measured", lambda self, now: _energise(self, now)),
    "START applies other outputs": (SimulatedBoard, "enter", _start_switches),
    "waiting RPDOs are switched after a stop": (BusCommit, "give_up", _give_up_late),
    "interlocks are ignored": (Readings, "interlock_faults", lambda self: []),
    "the loss of the planner begins no epoch": (Executor, "lose_planner", _begin_no_epoch),
    "marks settle again after a replacement": (ProgramExecution, "replace", _settle_again),
    "stages are taken again after a replacement": (ProgramExecution, "replace", _take_again),
    "programs wait for stages for ever": (ProgramExecution, "find_end", _wait_for_ever),
    "programs do not wait for stages": (ProgramExecution, "find_end", _do_not_wait_for_stages),
}


FOUND = {  # words of the violation, where another invariant could find the defect as well
    "START applies other outputs": "START switched",
    "waiting RPDOs are switched after a stop": "a SYNC for RPDOs that a stop",
    "pulses do not end": "a coil is on for",
    "the loss of the planner begins no epoch": "before the loss of its planner|the epoch is still",
    "marks settle again after a replacement": "is reported again|settled .* early|is told after",
    "stages are taken again after a replacement": "is reported after|comes after",
    "programs wait for stages for ever": "waits for stages for|all stages have settled'} are due",
    "programs do not wait for stages": "says 'the planner sent no further stages for 10 s' after|are due",
}


FIRST = {  # seed that finds the defect soonest; other seeds follow if it no longer does
    "stages wait neither for those before nor for a rest": 3,
    "switches are counted that were not made": 2,
    "a program goes on after cancel and halt": 2,
    "locks are taken whatever the end-stops read": 32,
    "pulses do not end": 1,
    "waiting RPDOs are switched after a stop": 2,
    "interlocks are ignored": 2,
    "marks settle again after a replacement": 22,
    "stages are taken again after a replacement": 19,
    "programs wait for stages for ever": 2,
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_defects_are_found(monkeypatch: pytest.MonkeyPatch, defect: str) -> None:
    monkeypatch.setattr(*DEFECTS[defect])
    with pytest.raises(Violation, match=FOUND.get(defect)):
        _run_until_one_fails(FIRST.get(defect, 0))


def _run_until_one_fails(first: int) -> None:
    for k in range(60):
        World((first + k) % 60).run(STEPS)
