"""One fault of the daemon's side in calm: exactly its row of this table is told, and it is over when the fault is."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.program import unpack

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.world import World

TOLD_WITHIN, BOOTED_WITHIN = 1.0, 30.0  # [s] from a cause to its warning, and back; until an executor is ready again
WARNED = 11.0  # [s] for which a warning of the shell stays after its cause, and a moment
LONG = 0.1  # share of such a warning, from that of others: the world is over soon


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
