"""What must work after all trouble has ended: the arm runs a program or a goal, and nothing is owed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from tests.simulation.judge.interface.results import unanswered
from tests.simulation.judge.verdict import Violation, require
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.whole.containers import check_containers

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.world import World

Payload = dict[str, Any]
OWED_WITHIN = 12.0  # [s]: results of an earlier process wait until clients have reconnected
MOST_TRIES = 6  # goals, until one is accepted; some cannot be reached
MOST_HUNG = 12  # goals that wait for a hung worker in vain, until the planner starts again
TRIED_AGAIN = 0.3  # [s]: what arrives within a second after a standstill may be refused as too late
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
    answer: Payload | None = None
    hung = world.trouble.made["a search hangs"] > 0
    for _ in range(MOST_TRIES + hung * MOST_HUNG):
        answer = send_goal(world, daemon)
        if answer is not None and answer["accepted"]:
            break
        world.pass_time(TRIED_AGAIN)
    else:
        raise Violation(f"no goal was accepted after all trouble: {answer}")
    name = answer["id"]
    world.wait(lambda: name in daemon.results, "done", DONE_WITHIN)
    daemon.wanted = False


def send_goal(world: World, daemon: Daemon) -> Payload | None:
    """Sends a goal when the arm is ready; returns the answer, None if no planner got it."""
    daemon.wanted = False
    patience = world.ready_within + (HUNG_WITHIN if world.trouble.made["a search hangs"] else RESTARTED_WITHIN)
    world.wait(lambda: daemon.at_rest and world.settled(), "ready for a goal", patience)
    daemon.wanted, process = True, daemon.process
    daemon.zenoh.gone.clear()
    sent = daemon.clients.ask("goal", daemon.clients.wishes.simple_goal())
    world.wait(lambda: sent.replies or daemon.process is not process, "answered", SEARCHED_WITHIN)
    return msgspec.json.decode(sent.replies[0]) if sent.replies else None


def check_daemon(world: World, daemon: Daemon) -> None:
    """Checks that every goal has its result, and that planner, ledger and executor agree on that."""
    storage, account = daemon.storage, daemon.judge.account
    world.wait(lambda: not unanswered(account), "without open requests", SEARCHED_WITHIN)
    world.wait(lambda: not storage.owed(), "without goals that the ledger owes", OWED_WITHIN)
    world.wait(lambda: not world.account.owed, "without results that wait", OWED_WITHIN)
    if daemon.process is not None:
        check_containers(daemon.process)
    counts = [max(known, told) for known, told in zip(storage.counts, daemon.counted, strict=True)]
    require(list(storage.counts) == counts, f"the ledger counts {storage.counts}, the executor {daemon.counted}")
    without = [ran.goal for ran in account.programs.values() if ran.request is not None and not ran.results]
    require(not without, f"{without} were accepted, and have no result")
