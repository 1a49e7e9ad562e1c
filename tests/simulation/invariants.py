"""Invariants that need facts of the world beside the judge's account: called at every step, they raise `Violation`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hyperbit.controller.program import TICK
from tests.simulation.buses.board_side import FOREIGN_START
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.judge.account import EPSILON
from tests.simulation.judge.verdict import Violation, require

if TYPE_CHECKING:
    from tests.simulation.world import World

LOOK_EVERY = 0.005  # [s] between two looks at the buses


def outputs_fall_only_with_a_cause(world: World) -> None:
    """Outputs change without a SYNC only by a fault, if a board did not hear the executor, or off by a boot."""
    timing, now = world.arm.timing, world.agenda.now
    for switch in world.record.step.switches:
        if switch.cause == "time":
            since = now - world.record.disturbed_at[switch.bus]
            excused = since < 2 * timing.heartbeat_timeout
            require(excused, f"{switch.mask:b} went off on {switch.bus} without a fault")
        elif switch.cause.startswith("frame 6"):  # the boot of a board that another program took out of operational
            off = world.judge.account.told in ("starting", "stopped") and not switch.mask & switch.after
            require(off, f"{switch.mask:b} switched by {switch.cause}")
        else:
            require(switch.cause in ("SYNC", "fault", FOREIGN_START), f"{switch.mask:b} switched by {switch.cause}")


def switches_are_counted(world: World) -> None:
    """The journal counts each switch of a SYNC once, also those of a killed executor after the next boot."""
    if not world.record.step.switches and not world.journal_changed():
        return
    journal, record = world.executor.journal, world.record
    for k, (counted, synced, slack) in enumerate(zip(journal.counts, record.synced, record.slack, strict=True)):
        open_ = world.intended >> k & 1
        require(counted <= synced + slack, f"actuator {k} switched {synced} times, the journal has {counted}")
        require(synced <= counted + slack + open_, f"actuator {k} switched {synced} times, the journal has {counted}")


def heartbeats_do_not_pause(world: World) -> None:
    """The executor sends heartbeats on each bus, unless it stalls, is dead, or the bus does not work."""
    record, now = world.record, world.agenda.now
    if now < record.looks_at:
        return
    record.looks_at = now + LOOK_EVERY
    for name, bus in world.buses.items():
        if not bus.healthy or not world.executor.awake:
            record.disturbed_at[name] = now
        elif bus.loss or world.boards.silent:
            record.disturbed_at[name] = now
            continue
        record.disturbed_at[name] = max(record.disturbed_at[name], world.executor.awake_since)
        gap = now - max(record.last_heartbeat[name], record.disturbed_at[name])
        require(gap <= world.arm.timing.heartbeat_timeout, f"{name}: no heartbeat of the executor for {gap:g} s")


def two_coils_are_never_on_at_once(world: World) -> None:
    """At most one of two coils is on, also during faults and boots."""
    if world.record.step.switches or world.record.step.energised:
        both = world.boards.both_on()
        require(not any(both), f"both coils of an actuator were on: {both}")


def no_start_changes_a_pin(world: World) -> None:
    """The NMT command START of the executor changes no output."""
    for switch in world.record.step.switches:
        require(switch.cause != "START", f"START switched {switch.mask:b} to {switch.after:b}")
    for coils in world.record.step.energised:
        require(coils.cause != "START", f"START switched on the coils {coils.came:b}")


def the_executor_has_no_defect(world: World) -> None:
    """The executor has caught no internal error."""
    for text in world.record.step.errors:
        raise Violation(text)


def coils_come_on_only_by_a_sync(world: World) -> None:
    """One of two coils comes on only by a SYNC, or where its board contracts its actuator without the executor.

    The START of another master ends the error state of a board, so that its pins follow its last command again
    (CiA 401). The last command of a killed executor may be a pulse. Nothing that a dead executor wrote prevents this.
    """
    for coils in world.record.step.energised:
        if coils.cause not in ("SYNC", FOREIGN_START):
            came = coils.came & ~world.record.suspect & ~world.let_go
            require(not came, f"the coils {came:b} came on by {coils.cause}")


def nothing_begins_while_an_interlock_is_open(world: World) -> None:
    """One period after the opening of an interlock, no RPDO is sent for a stage any more."""
    record, now = world.record, world.agenda.now
    if not world.arm.wiring.interlocks or record.open_since == math.inf:
        return
    lock = world.arm.wiring.interlocks[0]
    if not world.boards.takes_part(f"{lock.bus}/{lock.node}"):
        record.unread_at = now
    if not record.step.frames or now < record.open_since + TICK:
        return
    lost_at = world.buses[lock.bus].tpdo_lost_at
    if max(record.unread_at, record.disturbed_at[lock.bus], lost_at) >= record.open_since - EPSILON:
        return
    for name, frame in record.step.frames:
        commit = world.judge.account.commit
        if frame.id & 0x780 in RPDOS and commit is not None:
            require(commit.releases, f"{name}: RPDO {frame.id:03X}h while an interlock is open")


INVARIANTS = (
    the_executor_has_no_defect,
    no_start_changes_a_pin,
    outputs_fall_only_with_a_cause,
    switches_are_counted,
    heartbeats_do_not_pause,
    two_coils_are_never_on_at_once,
    coils_come_on_only_by_a_sync,
    nothing_begins_while_an_interlock_is_open,
)
