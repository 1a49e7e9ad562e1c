"""A control loop, the CAN driver and boards on a simulated clock and bus: months of switches in minutes.

Most periods bring a fresh goal, which replaces the one before; the rest leaves goals time to be reached, follows moving
goals, cancels, stops, resets, or cuts a board's supply.
"""

import sqlite3
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import numpy as np

from controller.daemon.events import Cancel, Follow, Planned, Reset, Stop
from controller.daemon.ledger import KEPT, Ledger
from controller.daemon.state import Diagnostics
from tests.daemon.rig import ARM, planned
from tests.fuzz.world import CHANNELS, NODES, World
from tests.soak.counting import SwitchCounter
from tests.soak.measuring import Memory

STEP = 0.04  # [s] between waypoints
SAMPLES = 500
ACTS = {"goal": 0.91, "trajectory": 0.04, "follow": 0.03, "cancel": 0.015, "stop": 0.004, "supply": 0.001}


class LongWorld(World):
    """The world of attacks without any: counts what is on its bus, and what becomes of its goals."""

    def __init__(self, ledger: Ledger) -> None:
        self.counter = SwitchCounter([(channel.node, channel.output) for channel in CHANNELS])
        self.answered = self.accepted = self.supplies = self.ticks = self.most_waiting = 0
        self.pending: set[str] = set()
        self.statuses: Counter[str] = Counter()
        super().__init__(ledger)

    def judge(self, message: can.Message) -> None:
        self.counter.take(message.arbitration_id, bytes(message.data))

    def publish(self, key: str, payload: Mapping[str, Any]) -> None:
        if key == "result":
            self.pending.remove(payload["id"])  # each result once, of a goal that was accepted
            self.statuses[payload["status"]] += 1

    def diagnose(self, diagnostics: Diagnostics) -> None:
        self.ticks += diagnostics.loop.ticks
        self.most_waiting = max(self.most_waiting, diagnostics.inbox)

    def run(self, *configurations: tuple[int, int]) -> None:
        """Hands a goal over."""
        self._arrival += 1
        name = str(self._arrival)

        def reply(payload: Mapping[str, Any]) -> None:
            self.answered += 1
            if payload["accepted"]:
                self.accepted += 1
                self.pending.add(name)

        self.loop.inbox.hand_over(Planned(self._arrival, reply, name, planned(*configurations, step=STEP)))

    def follow(self, configuration: tuple[int, int]) -> None:
        """Asks for a configuration as one that follows a moving goal does."""
        self._arrival += 1
        wanted, until = np.array(configuration, dtype=np.int64), self.now + 0.25
        self.loop.inbox.put(Follow(self._arrival, self.loop.commanded, wanted, until, "following"))


def committed(commits: int) -> dict[str, Any]:
    """Goes on until so many SYNCs were sent; returns the figures.

    Raises:
        AssertionError: something was lost, doubled or miscounted.
    """
    random, memory, acts = np.random.default_rng(6), Memory(SAMPLES + 1), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        ledger = Ledger(Path(folder) / "ledger.sqlite", ARM.actuators)
        world = LongWorld(ledger)
        began, due = world.now, 0
        for act in drawn(random):
            if world.counter.syncs >= due:
                memory.sample()
                due += max(commits // SAMPLES, 1)
            if world.counter.syncs >= commits:
                break
            acts[act] += 1
            perform(world, act, [(int(a), int(b)) for a, b in random.integers(0, 8, (3, 2))])
        world.request(Cancel)
        world.go(150)
        figures = {"commits": world.counter.syncs, "simulated_hours": (world.now - began) / 3600, "acts": dict(acts)}
        ledger.close(60.0)
        return {**figures, **checked(world, acts, Path(folder) / "ledger.sqlite"), "memory": memory.end()}


def drawn(random: np.random.Generator) -> Iterator[str]:
    """Gives acts at random, without end."""
    while True:
        yield from random.choice(list(ACTS), 1000, p=list(ACTS.values())).tolist()


def perform(world: LongWorld, act: str, configurations: list[tuple[int, int]]) -> None:
    """Lets one thing happen, and as much time pass as it takes."""
    match act:
        case "goal":
            world.run(configurations[0])
            world.go()
        case "trajectory":
            world.run(*configurations)
            world.go(15)
        case "follow":
            for configuration in configurations:
                world.follow(configuration)
                world.go(3)
        case "cancel":
            world.request(Cancel)
            world.go()
        case "stop":
            world.request(Stop)
            world.request(Reset)
            world.go(4)
        case "supply":
            world.supply(NODES[0], on=False)
            world.go(3)
            world.supply(NODES[0], on=True)
            world.recover()  # cuts the supply of all
            world.counter.off()


def checked(world: LongWorld, acts: Counter[str], ledger: Path) -> dict[str, Any]:
    """Compares what the loop said, what its ledger holds and what was on the bus."""
    assert world.answered == acts["goal"] + acts["trajectory"], "each goal is answered once"
    assert not world.pending, "each accepted goal has its result"
    assert world.statuses.total() == world.accepted
    with closing(sqlite3.connect(ledger)) as book:
        counts = dict(book.execute("SELECT actuator, count FROM switches").fetchall())
        rows = dict(book.execute("SELECT status, count(*) FROM goals GROUP BY status").fetchall())
    assert None not in rows, "each goal in the ledger has ended"
    assert sum(rows.values()) == min(world.accepted, KEPT), "each accepted goal is in the ledger"
    written = np.array([counts.get(label, 0) for label in ARM.actuators])
    assert written.sum() == world.loop._runner.switching.switches
    assert np.array_equal(written, world.counter.counts), "the ledger holds the switches that were on the bus"
    return {
        "goals": world.answered,
        "accepted": world.accepted,
        "results": dict(world.statuses),
        "switches": int(written.sum()),
        "ticks": world.ticks,
        "most_waiting": world.most_waiting,
    }
