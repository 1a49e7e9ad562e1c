"""Boards and the CANopen master in their simulated world; the judge must find planted defects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.drivers.canopen.boards.beat_count import BeatCount
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.boot import configuration, pdo_search
from hyperbit.drivers.canopen.boot.undo import Undo
from hyperbit.drivers.canopen.run.verification import Verification
from hyperbit.drivers.canopen.sdo.objects import Need
from tests.simulation.fieldbus.world import BoardWorld
from tests.simulation.judge.verdict import Violation

STEPS = 4_000
MOST_WORLDS = 30

_wanted, _synchronisation = OutputLines._wanted, configuration.synchronisation


@pytest.mark.parametrize("seed", range(8))
def test_boards_are_booted_switched_and_watched_as_the_pages_say(seed: int) -> None:
    BoardWorld(seed).run(STEPS)


def test_a_seed_replays_exactly() -> None:
    first, second = (BoardWorld(3, remembered=10**6) for _ in range(2))
    for world in (first, second):
        world.run(STEPS)
    assert second.story() == first.story()


def _zero_what_is_not_used(self: OutputLines, key: Any, states: int) -> int:
    return _wanted(self, key, states) & self.frames[key].used


def _leave_changes(self: Undo) -> Any:
    yield from ()


def _keep_the_window(*arguments: Any) -> list[Need]:
    return [need for need in _synchronisation(*arguments) if need.index != 0x1007]


def _silence_nothing(*arguments: Any) -> list[Need]:
    return []


def _never_twice(self: BeatCount, now: float, stalled: bool) -> bool:
    return False


def _see_no_error(self: Verification, board: Any) -> Any:
    yield from ()


DEFECTS: list[tuple[object, str, Callable[..., Any]]] = [
    (OutputLines, "_wanted", _zero_what_is_not_used),
    (Undo, "restore", _leave_changes),
    (configuration, "synchronisation", _keep_the_window),
    (pdo_search, "_silenced", _silence_nothing),
    (BeatCount, "twice", _never_twice),
    (Verification, "_errors", _see_no_error),
]


@pytest.mark.parametrize(("owner", "name", "defect"), DEFECTS, ids=[defect.__name__ for *_, defect in DEFECTS])
def test_a_planted_defect_is_found(
    owner: object, name: str, defect: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, defect)
    with pytest.raises(Violation):
        _run_worlds()


def _run_worlds() -> None:
    for seed in range(MOST_WORLDS):
        BoardWorld(seed).run(STEPS)
