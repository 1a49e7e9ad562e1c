"""Snapshots: when they are sent, and the executor's own warnings in them."""

from __future__ import annotations

import pytest

from hyperbit.controller.executor.core.events import ExecutorTick, Health
from hyperbit.controller.executor.core.reports import SNAPSHOT_EVERY
from hyperbit.controller.program import TICK, Fault, Snapshot, unpack
from hyperbit.drivers.canopen.faults import ArmFault, board_error, left_operational, remedy
from hyperbit.drivers.canopen.sdo.errors import Errors
from tests.executor.rig import Rig, ready


def test_no_snapshot_is_sent_between_the_rpdos_of_a_commit_and_its_sync() -> None:
    rig = ready()
    rig.master.slow_rpdos = True
    shown = len(rig.of(Snapshot))
    rig.run(0b111)
    assert len(rig.of(Snapshot)) == shown
    rig.master.slow_rpdos = False
    rig.go()
    assert len(rig.of(Snapshot)) > shown


def test_actuators_that_were_switched_and_not_read_back_are_told() -> None:
    rig = ready()
    rig.run(0b111)
    rig.go()
    rig.master.unread = 0b101
    rig.go(SNAPSHOT_EVERY + TICK)
    assert unpack(rig.snapshot.unread) == 0b101
    rig.master.unread = 0
    rig.go(SNAPSHOT_EVERY + TICK)
    assert unpack(rig.snapshot.unread) == 0


def test_a_journal_that_cannot_be_written_is_a_warning_until_it_can() -> None:
    rig = ready()
    rig.do(Health({}, 0, "the disk is full"))
    assert rig.snapshot.faults == (Fault("journal", "executor", "the disk is full"),)
    rig.do(Health({}, 0, None))
    assert rig.snapshot.faults == ()


@pytest.mark.parametrize("board", ["can0/5", f"{'b' * 64}/126"])
def test_the_longest_sentences_on_boards_keep_their_beginning_and_their_remedy(board: str) -> None:
    errors = Errors(0xFF, (0x8130,) * 254, complete=False)
    rig = ready()
    rig.master.fail(board_error(board, errors.words(0x2340)))
    rig.master.fail(
        ArmFault("board-stopped", board, left_operational(board, "without a command and is pre-operational"))
    )
    rig.go()
    assert len(rig.snapshot.faults) == 2
    for fault in rig.snapshot.faults:
        assert len(fault.message) <= 300
        assert fault.message.startswith(f"board {board} ")
        assert fault.message.endswith(remedy(board))


def test_the_awake_time_begins_with_the_first_tick_and_counts_a_late_tick_as_two() -> None:
    rig = Rig()
    rig.connect()
    assert rig.core.motion.clock == 0.0
    rig.go()
    assert rig.core.motion.clock == 0.0
    rig.go()
    assert rig.core.motion.clock == pytest.approx(TICK)
    rig.agenda.run(1.0)
    rig.do(ExecutorTick())
    assert rig.core.motion.clock == pytest.approx(3 * TICK)
