"""What must work after all trouble has ended: the arm runs a program or a goal, and nothing is owed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.simulation.judge.verdict import Violation, require
from tests.simulation.planner import ScriptedPlanner

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.whole.history import Asked
    from tests.simulation.world import World

MOST_TRIES = 6  # goals, until one is accepted; some cannot be reached
MOST_PROGRAMS = 30  # programs, one each 0.1 s, until one is accepted: the last switch may still be read back
RESTARTED_WITHIN = 10.0  # [s] until a planner or an executor that was killed has started again
HUNG_WITHIN = 200.0  # [s] until a planner with a hung worker has started again
SEARCHED_WITHIN = 75.0  # [s], longest time of a goal
DONE_WITHIN = 60.0  # [s], longest time of a program


def run_a_program(world: World) -> None:
    """Makes the scripted planner send a program, which ends with a result."""
    planner, record = world.planner, world.record
    assert isinstance(planner, ScriptedPlanner)
    for _ in range(MOST_PROGRAMS):
        world.wait(world.settled, "ready", world.ready_within)
        key = record.instance, planner.ask_for_motion()
        world.pass_time(0.1)
        if key in record.programs:
            break
    else:
        raise Violation(f"program {key[1]} was not accepted")
    if not record.programs[key].final and world.drawn_half():  # else it sends no further stages
        planner.die()
    world.wait(lambda: key in record.results, f"at the end of program {key[1]}", 30.0)


def run_a_goal(world: World, daemon: Daemon) -> None:
    """Makes a client send goals until one was accepted; its result is published."""
    for _ in range(MOST_TRIES):
        asked = send_goal(world, daemon)
        if asked is not None and asked.accepted:
            break
    else:
        raise Violation(f"no goal was accepted after all trouble: {asked and asked.payload}")
    assert asked.payload is not None
    name = asked.payload["id"]
    world.wait(lambda: any(r.payload["id"] == name for r in daemon.history.results.values()), "done", DONE_WITHIN)
    daemon.wanted = False


def send_goal(world: World, daemon: Daemon) -> Asked | None:
    """Sends a goal when the arm is ready; returns the answered request, None if no planner got it."""
    history = daemon.history
    daemon.wanted = False
    patience = world.ready_within + (HUNG_WITHIN if world.trouble.made["a search hangs"] else RESTARTED_WITHIN)
    world.wait(lambda: daemon.at_rest and world.settled(), "ready for a goal", patience)
    daemon.wanted, before = True, history.latest.get("goal")
    daemon.clients.ask("goal", daemon.clients.simple_goal())
    world.pass_time(0.01)
    asked = history.latest.get("goal")
    if asked is None or asked is before:
        return None
    world.wait(lambda: asked.payload is not None, "answered", SEARCHED_WITHIN)
    return asked


def check_daemon(world: World, daemon: Daemon) -> None:
    """Checks that every goal has its result, and that planner, ledger and executor agree on that."""
    history, storage = daemon.history, daemon.storage
    world.wait(lambda: not history.open, "without open requests", SEARCHED_WITHIN)
    world.wait(lambda: not storage.owed(), "without goals that the ledger owes", 5.0)
    core = world.executor.core
    assert core is not None
    world.wait(lambda: not core._results._stored, "without results that wait for their acknowledgement", 5.0)
    for name, accepted in history.goals.items():
        results = sum(result.payload["id"] == name for result in history.results.values())
        lost = len([asked for asked in accepted if asked.process in history.unwritten])
        require(
            results >= len(accepted) - lost, f"{name} was accepted {len(accepted)} times, and has {results} results"
        )
