"""The invariants of the whole daemon: functions that are called at every step, and raise `Violation`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from controller.planning.core.events import Identity
from controller.program import Acknowledge, unpack
from tests.simulation.judge.verdict import require
from tests.simulation.whole.configurations import first_touched
from tests.simulation.whole.refusals import unfounded

if TYPE_CHECKING:
    from tests.simulation.facts import Commit
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.world import World

COUNTED = "done"  # status of a program whose switches can be compared with those on the buses


def observe(world: World, daemon: Daemon) -> None:
    """Records what the executor has accepted and ended; comes first."""
    daemon.history.observe(world.record)


def each_request_has_one_answer(world: World, daemon: Daemon) -> None:
    """A request is answered once; an accepted goal runs, or has run, as a program of the executor."""
    history = daemon.history
    require(not history.strays, f"answers to requests that wait for none, or internal errors: {history.strays}")
    for asked in history.answered:
        if asked.key in ("goal", "jog") and asked.accepted and asked.payload is not None:
            name = asked.payload["id"]
            require(name in history.running, f"{name} was accepted, but the executor has accepted no such program")


def a_lost_connection_is_told(world: World, daemon: Daemon) -> None:
    """Without a connection to the executor, `state` does not tell that the arm is ready or moves."""
    require(not daemon.history.unfounded, "the state is ready or executing, without a connection to the executor")


def each_goal_has_one_result(world: World, daemon: Daemon) -> None:
    """A result is published once, or marked as repeated, and tells what the executor has told."""
    history = daemon.history
    require(not history.twice, f"the results of {history.twice} were published twice")
    for told in history.told:
        program = world.record.programs.get((told.identity.instance, told.identity.program))
        name = told.payload["id"]
        if program is None:
            require(told.payload["status"] == "lost", f"a result of {name}, which was not accepted")
            continue
        require(program.name.endswith(f" {name}"), f"the result of {program.name} has the id {name}")
        ended = history.ends.get(told.identity)
        if ended is not None and told.payload["switches"] != 0:
            words = f"{name} has {told.payload['switches']} switches, the executor counts {ended.switches}"
            require(told.payload["switches"] == ended.switches, words)


def results_are_acknowledged_last(world: World, daemon: Daemon) -> None:
    """A result is acknowledged after it was published and recorded; only what nobody waits for is not published."""
    history = daemon.history
    for message in history.sent:
        if not isinstance(message, Acknowledge):
            continue
        identity = history.by_result.get((history.connected_to, message.result))
        if identity is None:
            continue
        program = world.record.programs[identity]
        require(identity in history.recorded_results, f"the result of {program.name} was acknowledged, not recorded")
        name = program.name.split(" ", 1)[1]
        published = identity in daemon.storage.published
        wanted = [asked for asked in history.goals.get(name, []) if asked.process not in history.unwritten]
        excused = not wanted or any(result.payload["id"] == name for result in history.results.values())
        require(published or excused, f"the result of {program.name} was acknowledged, not published")


def switches_of_results_agree(world: World, daemon: Daemon) -> None:
    """A program that ran without faults has switched what its result says."""
    record, history = world.record, daemon.history
    for switch in record.step.switches:
        if switch.cause == "SYNC" and switch.commit is not None and switch.commit.running is not None:
            key = Identity(record.instance, switch.commit.running.number)
            history.bus_switches[key] += (switch.mask & ~switch.commit.locked & ~switch.commit.homing).bit_count()
    for coils in record.step.energised:
        # An actuator that did not follow its coil was adopted by its end-stop: the same coil comes on as a switch.
        if coils.cause == "SYNC" and coils.commit is not None and coils.commit.running is not None:
            key = Identity(record.instance, coils.commit.running.number)
            history.bus_switches[key] += (coils.again & ~coils.commit.locked & ~coils.commit.homing).bit_count()
    homes = record.commit is not None and (record.commit.homing or record.commit.realigns)
    if record.running is not None and (record.suspect or (record.step.frames and homes)):
        history.disturbed.add(Identity(record.instance, record.running.number))
    for ended, _ in record.step.ended:
        key = Identity(record.instance, ended.program)
        if ended.status == COUNTED and key not in history.disturbed and not record.suspect:
            counted = history.bus_switches[key]
            words = f"program {ended.program} has switched {counted} times, its result says {ended.switches}"
            require(counted == ended.switches, words)


def certificates_are_true(world: World, daemon: Daemon) -> None:
    """No plan from where the arm really was costs less than the certificate says."""
    history, record = daemon.history, world.record
    for program, _ in record.step.accepted:
        states = really(world) & ~record.locked | record.locked_states & record.locked
        identity, name = Identity(record.instance, program.program), program.name.split(" ", 1)[1]
        history.note_beginning(identity, name, states, record.locked)
    for told in history.told:
        payload, beginning = told.payload, history.beginnings.pop(told.identity, None)
        if beginning is None or payload.get("lower_bound") is None:
            continue
        least = daemon.least_cost(beginning, payload.get("bias"))
        words = f"the result of {payload['id']} has the lower bound {payload['lower_bound']}, {least} is possible"
        require(payload["lower_bound"] <= least, words)
        if payload["optimal"]:
            words = f"the result of {payload['id']} counts as optimal with {payload['switches']}, {least} is possible"
            require(payload["switches"] <= least, words)


def no_stage_touches_a_known_obstacle(world: World, daemon: Daemon) -> None:
    """A stage that begins after new obstacles were confirmed touches none of them."""
    record, history = world.record, daemon.history
    core = world.executor.core
    for switch in record.step.switches:
        commit = switch.commit
        # An actuator whose board has lost its supply has fallen before the executor knows.
        doubtful = record.suspect or record.fallen
        if switch.cause != "SYNC" or commit is None or commit.homing or doubtful or core is None:
            continue
        cubes = history.known_cubes
        if not cubes or commit.began <= history.cubes_at or daemon.unsure(record.lying) or core.ending.begun:
            continue
        stayed = (really(world) ^ world.boards.drives()) & ~switch.mask
        after = (switch.after ^ stayed) & ~commit.locked | commit.locked_states & commit.locked
        before = (switch.after ^ stayed ^ switch.mask) & ~commit.locked | commit.locked_states & commit.locked
        jogs = commit.running is not None and is_jog(world, commit.running.number)
        if jogs and not {before, start_of(world, commit)} <= daemon.space.index.keys():
            continue  # a jog from no configuration is not checked, in none of its stages, and its answer says so
        touched = first_touched(cubes, before, [after])
        require(touched is None, f"a stage from {before:b} to {after:b}: {touched}")


def nothing_runs_that_was_asked_before_a_stop(world: World, daemon: Daemon) -> None:
    """After an answered stop or cancel, no program begins whose request came before."""
    history = daemon.history
    for asked in history.answered:
        plain = asked.key == "stop" or (asked.key == "cancel" and asked.message.goal is None)
        if asked.accepted and plain and asked.process == daemon.number:
            history.barred_before = max(history.barred_before, asked.number)
    for program, _ in world.record.step.accepted:
        newest = history.newest(program.name.split(" ", 1)[1])
        words = f"{program.name} begins, but a stop or cancel was answered that came after it"
        require(newest is None or newest.number > history.barred_before, words)


def a_stopped_arm_waits_for_a_reset(world: World, daemon: Daemon) -> None:
    """After an answered stop nothing is switched until a reset was asked for."""
    history, record, core = daemon.history, world.record, world.executor.core
    for asked in history.answered:
        if asked.key == "stop" and asked.accepted and asked.process == daemon.number:
            history.stop = asked.at, world.agenda.now, record.instance
    if history.stop is None or core is None or core.ending.begun:
        return
    asked_at, answered_at, instance = history.stop
    for switch in record.step.switches:
        moved = switch.mask & ~record.suspect if switch.cause == "SYNC" and switch.commit is not None else 0
        if moved and switch.commit is not None and switch.commit.began > answered_at and instance == record.instance:
            require(history.reset_at >= asked_at, f"{moved:b} switched after a stop, without a reset")


def refusals_have_a_cause(world: World, daemon: Daemon) -> None:
    """No goal or jog is refused without a cause that holds."""
    for asked in daemon.history.answered:
        if asked.key in ("goal", "jog") and not asked.accepted:
            words = unfounded(asked, world, daemon)
            require(words is None, f"request {asked.number}, {asked.key}, was refused without a cause: {words}")


def is_jog(world: World, number: int) -> bool:
    """Returns whether a program of the present executor is a jog."""
    program = world.record.programs.get((world.record.instance, number))
    return program is not None and program.name.startswith("jog ")


def really(world: World) -> int:
    """Returns the ends to which the actuators are driven.

    An actuator with two coils that did not follow the last one stays where it is while both are off. The executor
    adopts it by its end-stop, so that a plan begins there.
    """
    drives, core = world.boards.drives(), world.executor.core
    if core is None:
        return drives
    positions = world.boards.positions()
    adopted = core.motion.kinds.paired & ~world.boards.coils() & ~(core.motion.actuation.states ^ positions)
    return drives & ~adopted | positions & adopted


def start_of(world: World, commit: Commit) -> int:
    """Returns the states from which the running program of a commit was planned."""
    assert commit.running is not None
    start = unpack(world.record.programs[world.record.instance, commit.running.number].start)
    return start & ~commit.locked | commit.locked_states & commit.locked


PLANNER_INVARIANTS: tuple[Callable[[World, Daemon], None], ...] = (
    observe,
    each_request_has_one_answer,
    a_lost_connection_is_told,
    each_goal_has_one_result,
    results_are_acknowledged_last,
    switches_of_results_agree,
    certificates_are_true,
    no_stage_touches_a_known_obstacle,
    nothing_runs_that_was_asked_before_a_stop,
    a_stopped_arm_waits_for_a_reset,
    refusals_have_a_cause,
)
