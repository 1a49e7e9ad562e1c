"""Defects of what the executor believes: the judge finds each, planted by hand, in the given seed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from controller.executor.motion.actuation import Actuation
from drivers.canopen.run.commit import BusCommit
from drivers.canopen.run.outputs import OutputLines
from drivers.canopen.run.switching import OutputSwitching
from drivers.canopen.run.verification import Verification
from drivers.canopen.wire.link import Link
from tests.simulation.judge.verdict import Violation
from tests.simulation.world import World

STEPS = 12_000

_read, _end_failed = OutputLines.read, OutputSwitching._end_failed


def _forget_missed(self: Verification) -> int:
    self._outputs.missed = 0
    return 0


def _wait_for_nothing(self: BusCommit, keys: Any) -> str | None:
    return "frames of the previous commit were not sent yet" if self.under_way else None


def _read_all(self: OutputLines, i: int, sub: int, byte: int) -> tuple[int, int]:
    right, wrong = _read(self, i, sub, byte)
    self.unread &= ~wrong
    return right | wrong, 0


def _verify_all(self: Any) -> int:
    return 0


DEFECTS: dict[str, tuple[type, str, Callable[..., Any] | property]] = {
    "goals are done before they are read back": (Actuation, "unproven", property(lambda self: 0)),
    "missed pulses are believed": (Verification, "drain_missed", _forget_missed),
    "the end of a pulse is sent once": (OutputLines, "mistrust", lambda *_: None),
    "lost echoes are waited for": (Link, "misses_echo", lambda *_: False),
    "what is read back is not compared": (OutputLines, "read", _read_all),
    "the pulse of a doubtful SYNC is not watched": (Actuation, "_watch_doubtful_pulses", lambda *_: 0),
    "RPDOs wait for no older ones": (BusCommit, "refusal", _wait_for_nothing),
    "overdue pulses are not told": (Actuation, "find_overdue", lambda *_: []),
}
FIRST: dict[str, int] = {}


@pytest.mark.parametrize("defect", DEFECTS)
def test_planted_defects_are_found(monkeypatch: pytest.MonkeyPatch, defect: str) -> None:
    monkeypatch.setattr(*DEFECTS[defect])
    with pytest.raises(Violation):
        World(FIRST[defect]).run(STEPS)
