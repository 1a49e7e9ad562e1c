"""Snapshots: when they are sent, and the executor's own warnings in them."""

from __future__ import annotations

import pytest

from hyperbit.controller.executor.core.events import ExecutorTick, Health
from hyperbit.controller.executor.core.reports import SNAPSHOT_EVERY
from hyperbit.controller.program import TICK, Fault, Snapshot, unpack
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
