"""`check --bus` and `run` on each variant with each error: the same verdict, or the check says that it cannot tell."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hyperbit.drivers.canopen.sdo.errors import MASTER_LOST
from tests.drivers.canopen.tools.test_bus_check import asked
from tests.drivers.rig import World
from tests.drivers.variants.cases import CASES, UNSEEN_WITHOUT_WRITING, Case
from tests.drivers.variants.test_boots import boot

HARDWARE, OVERLOAD, COMMUNICATION = (0x5000, 0x01), (0x2310, 0x03), (0x8140, 0x10)


def begin(*errors: tuple[int, int]) -> Callable[[World], None]:
    def happen(world: World) -> None:
        for error in errors:
            world.boards.board("can0/5").emergencies.report(*error)

    return happen


def end(*errors: tuple[int, int]) -> Callable[[World], None]:
    def happen(world: World) -> None:
        for code, _ in errors:
            world.boards.board("can0/5").emergencies.recover(code)

    return happen


def lose(world: World) -> None:
    world.stalled = True
    world.run(2.0)
    world.stalled = False


def restart(world: World) -> None:
    world.new_master()
    boot(world)


HISTORIES: dict[str, tuple[Callable[[World], None], ...]] = {
    "a hardware error": (begin(HARDWARE),),
    "a communication error": (begin(COMMUNICATION),),
    "an error that has ended": (begin(HARDWARE), end(HARDWARE)),
    "a loss": (restart, lose),
    "a loss, twice": (restart, lose, restart, lose),
    "a hardware error, and a loss": (restart, begin(HARDWARE), lose),
    "a loss, and a hardware error": (restart, lose, begin(HARDWARE)),
    "an overload, and a loss": (restart, begin(OVERLOAD), lose),
    "a communication error, and a loss": (restart, begin(COMMUNICATION), lose),
    "an error that has ended, and a loss": (restart, begin(HARDWARE), end(HARDWARE), lose),
    "two errors, one has ended, and a loss": (restart, begin(HARDWARE, OVERLOAD), end(OVERLOAD), lose),
    "a hardware error, and three losses": (restart, begin(HARDWARE), lose, restart, lose, restart, lose),
}
FIRST = {case.variant: case for case in sorted(reversed(CASES), key=lambda case: bool(case.refused), reverse=True)}
TRIED = [
    *FIRST.values(),
    *(case for case in CASES if case.label == "contract" and case.variant in ("standard", "kept-loss")),
]


@pytest.mark.parametrize("history", HISTORIES)
@pytest.mark.parametrize("case", TRIED, ids=lambda case: case.name)
def test_check_gives_the_verdict_of_run(case: Case, history: str):
    world = case.world()
    world.run(5.0)
    for happen in HISTORIES[history]:
        happen(world)
    [answer] = asked(world)
    restart(world)
    ready, told = world.master.outputs_known, [fault.message for fault in world.master.boot_faults]
    board = world.boards.board("can0/5")
    stands = any(code != MASTER_LOST for code in board.emergencies.present)
    assert not (ready and stands and board.objects.has(0x1003)), "an error was acknowledged"
    if "only run can tell" in answer.text:
        assert answer.code in ("", "board-stopped")
        assert "loss" in history
    elif case.variant not in UNSEEN_WITHOUT_WRITING:
        assert (not answer.code) == ready, (answer.text, told)
