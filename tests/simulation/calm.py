"""What must work when no trouble is left: programs, goals among obstacles, and the report of one fault."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from hyperbit.controller.program import unpack
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.statements.containers import check_containers
from tests.simulation.verdict import Violation, require

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.world import World

Payload = dict[str, Any]
OWED_WITHIN = 12.0  # [s]: results of an earlier process wait until clients have reconnected
MOST_HUNG = 12  # goals that wait for a hung worker in vain, until the planner starts again
SETTLES = 1.2  # [s]: what arrives within a second after a standstill may be refused as too late
GOALS, TOGETHER, DRAWN = 2, 3, 6  # most goals in calm one after another, and at once; most further requests
TASKS, PLANS, CHANGES = 8, 3, 2  # goals of a time of work, most plans before each, most changes of obstacles in each
BESIDE = (*("nothing",) * 8, *("obstacles",) * 4, *("degrade",) * 2, "cancel", "stop", "goal", "stream")
TROUBLES = ("disk", "fails", *("write",) * 3, *("death",) * 3)  # the executor dies in a write of its journal
STREAM = 0.3  # [s]
CHANGED_WITHIN = 0.2  # [s] of the begin of a goal, or of another change
TOLD_WITHIN, BOOTED_WITHIN = 1.0, 30.0  # [s] from a cause to its warning, and back; until an executor is ready again
WARNED = 11.0  # [s] for which a warning of the shell stays after its cause, and a moment
LONG = 0.1  # share of such a warning, from that of others: the world is over soon
MOST_PROGRAMS = 30  # programs, one each 0.1 s, until one is accepted: the last switch may still be read back
RESTARTED_WITHIN = 10.0  # [s] until a planner or an executor that was killed has started again
HUNG_WITHIN = 200.0  # [s] until a planner with a hung worker has started again
SEARCHED_WITHIN = 75.0  # [s], longest time of a goal
DONE_WITHIN = 60.0  # [s], longest time of a program


def run_a_program(world: World) -> None:
    """Makes the scripted planner send a program, which ends with a result."""
    planner, record = world.planner, world.record
    assert isinstance(planner, ScriptedPlanner)
    strict = world.drawn_half()
    for _ in range(MOST_PROGRAMS):
        world.wait(world.settled, "ready", world.ready_within)
        key = record.instance, planner.ask_for_motion(strict)
        world.pass_time(0.1)
        if key in record.programs:
            break
    else:
        raise Violation(f"program {key[1]} was not accepted")
    if not record.programs[key].final and world.drawn_half():  # else it sends no further stages
        planner.die()
    world.wait(lambda: key in record.results, f"at the end of program {key[1]}", 30.0)


def run_a_goal(world: World, daemon: Daemon) -> None:
    """Makes a client send a goal when the arm is ready; it succeeds, and so do others."""
    hung = world.trouble.made["a search hangs"] > 0
    daemon.wanted, answer = False, None
    for _ in range(1 + hung * MOST_HUNG):
        patience = world.ready_within + (HUNG_WITHIN if hung else RESTARTED_WITHIN)
        world.wait(lambda: daemon.at_rest and world.settled(), "ready for a goal", patience)
        if daemon.exchange.happened("standstill", world.agenda.now - SETTLES):
            world.pass_time(SETTLES)
        daemon.wanted, process = True, daemon.process
        daemon.zenoh.gone.clear()
        answer = ask(world, daemon, "goal", daemon.clients.wishes.simple_goal(), () if hung else ("accepted",))
        if answer is not None or daemon.process is process:
            break
    require(answer is not None and answer["accepted"], f"no goal was accepted after all trouble: {answer}")
    for left in reversed(range(1 + world.drawn(GOALS))):
        assert answer is not None
        name = answer["id"]
        world.wait(lambda name=name: name in daemon.results, "done", DONE_WITHIN)  # type: ignore[misc]
        world.account.see("tried", daemon.results[name])
        if left:
            answer = ask(world, daemon, "goal", daemon.clients.wishes.sure_goal(), ("accepted",))
    if world.drawn_half():
        ask_in_calm(world, daemon)
    daemon.wanted = False
    world.wait(lambda: not daemon.exchange.running, "at the end of all goals", DONE_WITHIN)


def ask_in_calm(world: World, daemon: Daemon) -> None:
    """Sends requests that are answered as they were drawn: goals at once, then others at rest."""
    goals = [daemon.clients.wishes.simple_goal() for _ in range(world.drawn(TOGETHER))]
    together = [daemon.clients.ask("goal", goal, drawn=("accepted", "state-in-between")) for goal in goals]
    world.wait(lambda: all(sent.replies for sent in together), "answered", SEARCHED_WITHIN)
    for _ in range(world.drawn(DRAWN)):
        world.wait(lambda: daemon.at_rest and world.settled(), "ready for a request", world.ready_within)
        ask(world, daemon, *daemon.clients.wishes.drawn())


def work(world: World, daemon: Daemon, peaceful: bool) -> None:
    """Lets clients set obstacles, ask for plans at rest, then for a goal; one thing happens beside each goal."""
    clients, wishes = daemon.clients, daemon.clients.wishes
    every = BESIDE if peaceful else BESIDE + TROUBLES
    daemon.wanted = True

    def mend() -> None:
        daemon.mend()
        world.executor.recover()

    for _ in range(TASKS):
        mend()
        world.wait(lambda: not daemon.exchange.running and world.settled(), "at rest", world.ready_within)
        if world.drawn_half():
            ask(world, daemon, "obstacles", {"regions": wishes.regions()}, ())
        beside = every[world.drawn(len(every) - 1)]
        if beside in TROUBLES:
            world.disturb()
        match beside:
            case "degrade":
                ask(world, daemon, "degrade", wishes.lock(), ())
            case "disk":
                daemon.fill_disk(world.drawn(3))
            case "fails":
                daemon.mood.fails = 0.5
            case "write":
                world.executor.die_in_write()
            case "death":
                daemon.die()
        for _ in range(world.drawn(PLANS)):
            ask(world, daemon, "plan", wishes.goal(), ())
        answer = ask(world, daemon, "goal", wishes.goal(), ())
        if answer is None or not answer["accepted"]:
            continue
        for _ in range(0 if beside == "nothing" else world.drawn(CHANGES)):
            world.pass_time(CHANGED_WITHIN * world.share())
            if beside == "obstacles":
                clients.ask("obstacles", {"regions": wishes.regions()})
            elif beside in ("cancel", "stop", "goal"):
                clients.ask(beside, wishes.goal() if beside == "goal" else {})
            elif beside == "stream":
                clients.stream(STREAM)
        world.wait(lambda name=answer["id"]: name in daemon.results, "done", DONE_WITHIN)  # type: ignore[misc]
    mend()
    over = "at the end of all goals"
    world.wait(lambda: daemon.state is not None and not daemon.exchange.running, over, DONE_WITHIN)
    daemon.wanted = False
    check_daemon(world, daemon)


def ask(world: World, daemon: Daemon, key: str, payload: Payload | bytes, drawn: tuple[str, ...]) -> Payload | None:
    """Sends a request and waits for its answer; None if the planner has ended without one."""
    process, sent = daemon.process, daemon.clients.ask(key, payload, drawn=drawn)
    world.wait(lambda: sent.replies or daemon.process is not process, "answered", SEARCHED_WITHIN)
    return msgspec.json.decode(sent.replies[0]) if sent.replies else None


def check_daemon(world: World, daemon: Daemon) -> None:
    """Checks that every goal has its result, and that planner, ledger and executor agree on that."""
    storage, account = daemon.storage, daemon.exchange
    world.wait(lambda: not account.unanswered(), "without open requests", SEARCHED_WITHIN)
    world.wait(lambda: storage.ledger is None or storage.ledger.fault is None, "with a ledger", OWED_WITHIN)
    world.wait(lambda: not storage.owes(), "without goals that the ledger owes", OWED_WITHIN)
    world.wait(lambda: not world.account.owed, "without results that wait", OWED_WITHIN)
    if daemon.process is not None:
        check_containers(daemon.process)
    counts = [max(known, told) for known, told in zip(storage.counts, daemon.counted, strict=True)]
    require(list(storage.counts) == counts, f"the ledger counts {storage.counts}, the executor {daemon.counted}")
    world.account.see("told_all")


# --- one fault of the daemon's side: exactly its row is told, and it is over when the fault is


class Row(NamedTuple):
    """A fault: its code, how it begins and ends, and when it is over [s]."""

    code: str
    begin: Callable[[], object]
    end: Callable[[], object]
    over: float
    also: frozenset[str] = frozenset()  # codes that may be told, too


def one_fault(world: World, daemon: Daemon, random: Random) -> None:
    """Lets one fault happen; calm clients remove obstacles and locks by themselves."""
    rows = _rows(world, daemon, random)
    row = random.choices(rows, [LONG if row.over == WARNED else 1.0 for row in rows])[0]
    before = codes(daemon)
    daemon.wanted = True
    world.account.see("breaks", before | row.also | {row.code})
    row.begin()
    world.wait(lambda: row.code in codes(daemon), f"told as {row.code}", TOLD_WITHIN + BOOTED_WITHIN * bool(row.also))
    row.end()
    world.wait(lambda: daemon.state is not None and row.code not in codes(daemon), f"without {row.code}", row.over)
    world.account.see("is_mended")
    daemon.wanted = False


def codes(daemon: Daemon) -> set[str]:
    return set() if daemon.state is None else {fault["code"] for fault in daemon.state["faults"]}


def _rows(world: World, daemon: Daemon, random: Random) -> list[Row]:
    clients, snapshot, labels = daemon.clients, daemon.snapshot, daemon.executed.actuators
    assert snapshot is not None
    booting = frozenset(("unknown-position", "executor-lost", "outputs-off", "board-lost"))

    def fill_disk() -> None:
        daemon.fill_disk(0)
        clients.ask("goal", clients.wishes.simple_goal())

    rows = [
        Row("network-lost", lambda: daemon.lose_network(True), lambda: daemon.lose_network(False), WARNED),
        Row("clock-set", lambda: daemon.set_clock(3600.0), lambda: None, WARNED),
        Row("ledger-unwritten", fill_disk, daemon.mend, TOLD_WITHIN),
        Row("executor-lost", world.executor.kill, lambda: None, BOOTED_WITHIN, booting),
    ]
    if (at := daemon.space.index.get(unpack(snapshot.measured))) is not None:  # a jog may leave what the arm may take
        here = {"disc": {"centre": daemon.space.tips[at].tolist(), "radius": 0.01}, "name": "here"}
        regions = {"regions": [here]}
        rows.append(Row("in-obstacle", lambda: clients.ask("obstacles", regions), lambda: None, TOLD_WITHIN))
    free = [label for k, label in enumerate(labels) if not unpack(snapshot.locked) >> k & 1]
    if free:
        label = random.choice(free)
        lock = {"actuator": label, "state": unpack(snapshot.measured) >> labels.index(label) & 1}
        rows.append(Row("degraded", lambda: clients.ask("degrade", lock), lambda: None, TOLD_WITHIN))
    return [row for row in rows if row.code not in codes(daemon)]
