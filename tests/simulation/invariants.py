"""The invariants of the world: functions that are called at every step, and raise `Violation`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from controller.executor.core.bits import indices
from controller.executor.motion.program_execution import FED_WITHIN, STARVED
from controller.program import TICK, Begun
from drivers.canopen.wire import cia301
from tests.simulation.buses.board_side import FOREIGN_START
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.facts import Switch
from tests.simulation.judge.verdict import Violation, require
from tests.simulation.record import LATE

if TYPE_CHECKING:
    from tests.simulation.world import World

SETTLED_WITHIN = 3.0  # [s], longest time in which the last stage of a program settles, or is a fault


def outputs_change_only_as_asked(world: World) -> None:
    """A SYNC switches the boards to a stage of the running program or set-point, never to an earlier one."""
    for switch in _by_sync(world):
        mask, commit = switch.mask & ~world.record.suspect, switch.commit
        if not mask:
            continue
        require(commit is not None, f"a SYNC without RPDOs switched {mask:b}")
        assert commit is not None
        away = mask & commit.homing & (switch.after ^ commit.homes)
        require(not away, f"{away:b} of unknown state switched away from the guessed state")
        mask &= ~(commit.locked | commit.homing)  # see locked_actuators_switch_only_to_their_states
        if not mask:
            continue
        fitting = [(k, states) for k, states in commit.candidates if not (states ^ switch.after) & mask]
        require(fitting, f"{switch.mask:b} switched to {switch.after:b}; requested were {commit.candidates}")
        commit.candidates = fitting
        if commit.running is not None:
            commit.running.last = max(commit.running.last, fitting[0][0])


def nothing_is_commanded_without_a_request(world: World) -> None:
    """RPDOs and SYNCs are sent only for a request, and a SYNC soon after its RPDOs."""
    record = world.record
    for bus, frame in record.step.frames:
        if frame.id & 0x780 in RPDOS:
            commit = record.commit
            assert commit is not None
            asked = commit.candidates or commit.realigns or commit.releases or commit.homing
            require(asked, f"{bus}: RPDO {frame.id:03X}h in mode {record.mode}, and no stage is due")
        elif frame.id == cia301.SYNC:
            commit = record.commit
            require(commit is not None, f"{bus}: SYNC without RPDOs")
            assert commit is not None
            delay = world.agenda.now - commit.began
            longest = world.arm.timing.heartbeat_timeout / 2
            require(delay <= longest + 1e-6, f"{bus}: SYNC {delay:g} s after the RPDOs, of {longest:g} s at most")
        elif frame.id & 0x780 == cia301.SDO_REQUEST and len(frame.data) == 8:
            written = frame.data[0] & 0xE0 == 0x20 and frame.data[1:3] == b"\x00\x62"
            # The boot writes outputs as the pins are, or off; it goes on after a stop, and may end in the same step.
            require(not written or record.step.booting, f"{bus}: outputs were written by SDO")


def outputs_fall_only_with_a_cause(world: World) -> None:
    """Outputs change without a SYNC only by a fault, if a board did not hear the executor, or off by a boot."""
    timing, now = world.arm.timing, world.agenda.now
    for switch in world.record.step.switches:
        if switch.cause == "time":
            since = now - world.record.disturbed_at[switch.bus]
            excused = since < 2 * timing.heartbeat_timeout
            require(excused, f"{switch.mask:b} went off on {switch.bus} without a fault")
        elif switch.cause.startswith("frame 6"):  # the boot of a board that another program took out of operational
            core = world.executor.core
            off = core is not None and core._master.booting and not switch.mask & switch.after
            require(off, f"{switch.mask:b} switched by {switch.cause}")
        else:
            require(switch.cause in ("SYNC", "fault", FOREIGN_START), f"{switch.mask:b} switched by {switch.cause}")


def each_program_has_one_result(world: World) -> None:
    """A result belongs to an accepted program, and is sent again only until it is acknowledged."""
    record = world.record
    for ended, _ in record.step.ended:
        key = record.instance, ended.program
        require(key in record.programs, f"a result for program {ended.program}, which was not accepted")
        require(record.results.setdefault(key, ended.result) == ended.result, f"two results of program {ended.program}")
        acknowledged = (record.instance, ended.result) in record.acknowledged
        require(not acknowledged, f"result {ended.result} was sent after it was acknowledged")
        require(record.programs[key].context == ended.context, f"result {ended.result} has another context")


def programs_are_accepted_only_as_they_should_be(world: World) -> None:
    """A program is accepted only in its epoch, from the outputs that the boards have, in a mode that allows it."""
    record = world.record
    for program, accepted in record.step.accepted:
        number, begin = program.program, program.begin or world.agenda.now
        require(abs(accepted.begin - begin) < LATE, f"program {number} begins at {accepted.begin:g}, not {begin:g}")
        before = int.from_bytes(program.start, "little")
        for states in (int.from_bytes(stage.states, "little") for stage in program.stages):
            require((states ^ before).bit_count() <= world.most, f"program {number} switches too many at once")
            require(not (states ^ before) & record.locked, f"program {number} switches a locked actuator")
            before = states


def epochs_and_modes_are_respected(world: World) -> None:
    """An accepted program belongs to the last shown epoch.

    Each cancel, halt, fault and loss of the planner begins a new epoch.
    """
    for epoch, least in world.record.step.epochs:
        require(epoch >= least, f"the epoch is {epoch} after {least} cancels, halts, faults and lost planners")
    for program, _ in world.record.step.accepted:
        require(program.epoch == world.epoch_before, f"program {program.program} is of epoch {program.epoch}")
        require(world.mode_before in ("ready", "executing"), f"a program was accepted in mode {world.mode_before}")


def a_lost_planner_bars_what_it_planned(world: World) -> None:
    """No program is accepted that was planned before its planner was silent or gone."""
    for program, _ in world.record.step.accepted:
        barred = world.record.barred
        require(program.epoch > barred, f"program {program.program} was planned before the loss of the planner")


def stages_and_marks_are_reported_once(world: World) -> None:
    """Stages are reported in order, and each mark once, for the stage reached last, also over replacements."""
    for message, running in world.record.step.progress:
        if isinstance(message, Begun):
            known = running.taken < message.stage < len(running.stages)
            require(known, f"stage {message.stage} of program {running.number} is reported after {running.taken}")
            running.take(message.stage, world.record.locked)
            continue
        text = f"mark {message.mark} of program {running.number} is reported"
        require(running.settled < running.taken, f"{text} again")
        require(message.mark == running.marks[running.taken], f"{text} after stage {running.taken}")
        require(not (message.planned and running.skipped), f"{text} as planned, but a stage was skipped")
        running.settled = running.taken


def programs_without_further_stages_end(world: World) -> None:
    """A program whose planner sends no further stages ends, and not before its time."""
    for ended, running in world.record.step.ended:
        if running is not None and STARVED in ended.message:
            waited = running.unfed if running.starves else 0.0
            require(waited > FED_WITHIN - TICK, f"program {ended.program} was given up after {waited:g} s")
    running = world.record.running
    if running is not None and running.starves:
        require(running.unfed < FED_WITHIN + SETTLED_WITHIN, f"program {running.number} waits for stages for ever")


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
    for name, bus in world.buses.items():
        if not bus.healthy or not world.executor.awake:
            record.disturbed_at[name] = now
        elif bus.loss or world.boards.silent:
            record.disturbed_at[name] = now
            continue
        record.disturbed_at[name] = max(record.disturbed_at[name], world.executor.awake_since)
        gap = now - max(record.last_heartbeat[name], record.disturbed_at[name])
        require(gap <= world.arm.timing.heartbeat_timeout, f"{name}: no heartbeat of the executor for {gap:g} s")


def inrush_and_rest_hold(world: World) -> None:
    """At most `inrush` actuators switch at once, each stage waits for the previous one, and all actuators rest."""
    record, arm, now, travel = world.record, world.arm, world.agenda.now, world.kinds.travel
    for switch in _by_sync(world):
        commit, mask = switch.commit, switch.mask & ~record.suspect
        if commit is None or not mask:
            continue
        commit.switched |= mask
        require(commit.switched.bit_count() <= world.most, f"{commit.switched:b} switched at once")
        if record.last_commit is not None and record.last_commit[0] is not commit and arm.inrush is not None:
            pause = now - record.last_commit[1]
            least = max(travel[k][record.last_after >> k & 1] for k in indices(record.last_commit[0].switched))
            require(pause >= least - LATE, f"{mask:b} switched {pause:g} s after the stage before")
        for k in indices(mask):
            pause = now - record.switched_at[k]
            least = travel[k][1 - (switch.after >> k & 1)] + arm.rest if arm.rest else 0.0
            require(pause >= least - LATE, f"actuator {k} switched {pause:g} s after it switched last")
            record.switched_at[k] = now
        record.last_commit, record.last_after = (commit, now), switch.after


def two_coils_are_never_on_at_once(world: World) -> None:
    """At most one of two coils is on, also during faults and boots."""
    both = world.boards.both_on()
    require(not any(both), f"both coils of an actuator were on: {both}")


def coils_come_on_only_as_asked(world: World) -> None:
    """One of two coils comes on only by a SYNC whose RPDOs were sent for a request.

    The START of another master ends the error state of a board, so that its pins follow its last command again
    (CiA 401). The last command of a killed executor may be a pulse. Nothing that a dead executor wrote prevents this.
    """
    lost = sum(1 << k for k, level in zip(world.arm.wiring.paired, _off_levels(world), strict=True) if level == 1)
    for coils in world.record.step.energised:
        came, commit = coils.came & ~world.record.suspect, coils.commit
        if coils.cause == FOREIGN_START:
            continue
        if coils.cause != "SYNC":
            came &= ~lost  # its board contracts it without the executor
            require(not came, f"the coils {came:b} came on by {coils.cause}")
        elif came:
            asked = commit is not None and (commit.candidates or commit.realigns or commit.homing)
            require(asked, f"the coils {came:b} came on without a request")


def pulses_end(world: World) -> None:
    """A pulse ends within its length, one period, and the time in which the executor could not reach the board."""
    record, now = world.record, world.agenda.now
    for k, length in world.kinds.pulse.items():
        since = record.energised_at[k]
        if since is None or record.suspect >> k & 1:
            continue
        away, record.unreached[k] = record.unreached[k], not world.reaches(k)
        record.away[k] += (now - record.looked_at[k]) * away
        record.looked_at[k] = now
        longest = length + record.away[k] + TICK * (1 + (record.away[k] > 0.0))  # the executor hears of it, then acts
        require(now - since <= longest + LATE, f"actuator {k}: a coil is on for {now - since:g} s, of {longest:g} s")


def nothing_switches_after_a_stop(world: World) -> None:
    """No output changes by a SYNC sent after the answer to a halt or cancel, until a later request to move."""
    record = world.record
    for change in (*_by_sync(world), *record.step.energised):
        mask = (change.mask if isinstance(change, Switch) else change.came) & ~record.suspect
        if change.cause != "SYNC" or change.commit is None or not mask:
            continue
        late = change.commit.synced_at is not None and change.commit.synced_at > record.stopped_at
        require(not late, f"{mask:b} switched {world.agenda.now - record.stopped_at:g} s after a stop was answered")


def no_start_changes_a_pin(world: World) -> None:
    """The NMT command START of the executor changes no output."""
    for switch in world.record.step.switches:
        require(switch.cause != "START", f"START switched {switch.mask:b} to {switch.after:b}")
    for coils in world.record.step.energised:
        require(coils.cause != "START", f"START switched on the coils {coils.came:b}")


def nothing_begins_while_an_interlock_is_open(world: World) -> None:
    """One period after the opening of an interlock, no RPDO is sent for a stage any more."""
    record, now = world.record, world.agenda.now
    if not world.arm.wiring.interlocks:
        return
    lock = world.arm.wiring.interlocks[0]
    if not world.boards.takes_part(f"{lock.bus}/{lock.node}"):
        record.unread_at = now
    if not record.step.frames or now < record.open_since + TICK:
        return
    lost_at = world.buses[lock.bus].tpdo_lost_at
    if max(record.unread_at, record.disturbed_at[lock.bus], lost_at) >= record.open_since - LATE:
        return
    for name, frame in record.step.frames:
        if frame.id & 0x780 in RPDOS and record.commit is not None:
            require(record.commit.releases, f"{name}: RPDO {frame.id:03X}h while an interlock is open")


def locked_actuators_switch_only_to_their_states(world: World) -> None:
    """A SYNC switches a locked actuator only to its locked state, and only for a request."""
    for switch in _by_sync(world):
        if (commit := switch.commit) is not None:
            moved = switch.mask & commit.locked & ~world.record.suspect
            require(commit.realigns or not moved, f"the locked actuators {moved:b} switched without a request")
            away = moved & (switch.after ^ commit.locked_states)
            require(not away, f"the locked actuators {away:b} switched away from their states")


def the_executor_has_no_defect(world: World) -> None:
    """The executor has caught no internal error."""
    for text in world.record.step.errors:
        raise Violation(text)


def _off_levels(world: World) -> list[int | None]:
    return list(world.arm.wiring.loss_levels[len(world.arm.actuators) :])


def _by_sync(world: World) -> list[Switch]:
    return [switch for switch in world.record.step.switches if switch.cause == "SYNC"]


INVARIANTS = (
    the_executor_has_no_defect,
    outputs_change_only_as_asked,
    nothing_is_commanded_without_a_request,
    no_start_changes_a_pin,
    outputs_fall_only_with_a_cause,
    each_program_has_one_result,
    programs_are_accepted_only_as_they_should_be,
    epochs_and_modes_are_respected,
    a_lost_planner_bars_what_it_planned,
    stages_and_marks_are_reported_once,
    programs_without_further_stages_end,
    switches_are_counted,
    heartbeats_do_not_pause,
    inrush_and_rest_hold,
    locked_actuators_switch_only_to_their_states,
    two_coils_are_never_on_at_once,
    coils_come_on_only_as_asked,
    pulses_end,
    nothing_switches_after_a_stop,
    nothing_begins_while_an_interlock_is_open,
)
