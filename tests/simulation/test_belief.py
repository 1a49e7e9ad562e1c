"""Defects of what the executor believes: the judge finds each, planted by hand, by single faults of pulses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.executor.motion.actuation import Actuation
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.run.verification import Verification
from hyperbit.drivers.canopen.wire.link import Link
from tests.simulation.fault_kinds import FaultKinds
from tests.simulation.judge.verdict import Violation
from tests.simulation.single_fault import Fault
from tests.simulation.single_faults import SingleFaults
from tests.simulation.world import World

STEPS = 8_000
ROUNDS = 40  # worlds

_read = OutputLines.read


def _forget_missed(self: Verification) -> int:
    self._outputs.missed = 0
    return 0


def _read_all(self: OutputLines, i: int, sub: int, byte: int) -> tuple[int, int]:
    right, wrong = _read(self, i, sub, byte)
    self.unread &= ~wrong
    return right | wrong, 0


DEFECTS: dict[str, tuple[type, str, Callable[..., Any] | property]] = {
    "goals are done before they are read back": (Actuation, "unproven", property(lambda self: 0)),
    "missed pulses are believed": (Verification, "drain_missed", _forget_missed),
    "the end of a pulse is sent once": (OutputLines, "mistrust", lambda *_: None),
    "lost echoes are waited for": (Link, "misses_echo", lambda *_: False),
    "what is read back is not compared": (OutputLines, "read", _read_all),
    "the pulse of a doubtful SYNC is not watched": (Actuation, "_watch_doubtful_pulses", lambda *_: 0),
}
FIRST = {  # seed that finds a defect soonest
    "goals are done before they are read back": 2,
    "what is read back is not compared": 36,
    "missed pulses are believed": 20,
    "lost echoes are waited for": 1,
}

_possible = FaultKinds.possible


def _only_pulses(self: FaultKinds) -> dict[str, Fault]:
    return self._pulses.draw() or _possible(self)


@pytest.mark.parametrize("defect", DEFECTS)
def test_planted_defects_are_found(monkeypatch: pytest.MonkeyPatch, defect: str) -> None:
    monkeypatch.setattr(*DEFECTS[defect])
    monkeypatch.setattr(FaultKinds, "possible", _only_pulses)
    monkeypatch.setattr(SingleFaults, "_others", lambda self, planner: {})
    with pytest.raises(Violation):
        _run_until_one_fails(FIRST.get(defect, 0))


def _run_until_one_fails(first: int) -> None:
    for k in range(ROUNDS):
        world = World((first + k) % ROUNDS)
        if world.kinds.pulse:
            world.run(STEPS)
