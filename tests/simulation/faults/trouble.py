"""Faults of the table at random times, beside each other, and at the wrong moment."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING

from tests.simulation.faults.fault import Deck, Fault, Row
from tests.simulation.faults.table import rows

if TYPE_CHECKING:
    from tests.simulation.world import World

MOMENTS = ("now", "now", "now", "in mid boot", "in mid commit", "while the arm is stopped")
# What faults strike; with their shares in worlds with the whole daemon.
WHOLE = {("process", "daemon"): 0.65, ("actuator",): 0.15, ("bus", "board", "executor"): 0.2}
MID_BOOT = 0.3  # [s], longest time from a start of the executor to a fault in its boot


class Trouble:
    """Draws faults, about one a second; each ends after a time, and all with the trouble.

    Each fault comes as often as the others; with the whole daemon each as often as others of its kind. Then half of
    all trouble strikes processes only: goals run beside.
    """

    def __init__(self, world: World, random: Random, seed: int) -> None:
        self.made: Counter[str] = Counter()
        self._world, self._random = world, random
        whole = world.daemon is not None
        kinds = [rows(*kind) for kind in (WHOLE if whole else [tuple(kind for one in WHOLE for kind in one)])]
        self._decks = [Deck([row for row in kind if row.anytime], random, seed) for kind in kinds]
        self._every = [list(WHOLE.values()), [1.0, 0.0, 0.0]] if whole else [[1.0]]
        self._shares = self._every[0]
        self._mean = random.choice([0.15, 0.4, 1.0] if whole else [0.3, 1.0, 3.0])
        self._ends: list[Fault] | None = None  # of the present trouble; None: there is none

    def begin(self) -> None:
        self._ends, self._shares = [], self._random.choice(self._every)
        self._next(self._ends)

    def end(self) -> None:
        ends, self._ends = self._ends or [], None
        for fault in ends:
            fault.end()
        self._world.mend()

    def _during(self, ends: list[Fault], happen: Callable[[], object]) -> Callable[[], None]:
        """Returns what happens only while the present trouble lasts."""
        return lambda: happen() and None if self._ends is ends else None

    def _next(self, ends: list[Fault]) -> None:
        def happen() -> None:
            deck = self._random.choices(self._decks, self._shares)[0]
            drawn = deck.draw(self._world, alone=False)
            if drawn is not None:
                self._strike(ends, *drawn)
            self._next(ends)

        self._world.agenda.after(self._random.expovariate(1 / self._mean), self._during(ends, happen))

    def _strike(self, ends: list[Fault], row: Row, fault: Fault) -> None:
        world, moment = self._world, self._random.choice(MOMENTS)
        self.made[row.name] += 1
        self.made[moment] += 1
        world.note(f"fault: {row.name}, {moment}")

        def begin() -> None:
            ends.append(fault)
            fault.begin()
            world.agenda.after(self._random.uniform(0.0, row.longest), self._during(ends, fault.end))
            if row.name == "door is opened":
                world.agenda.after(self._random.uniform(0.0, 0.5), self._during(ends, world.ask_to_reset))

        strike = self._during(ends, begin)
        if moment == "in mid boot":
            delay = self._random.uniform(0.0, MID_BOOT)
            world.executor.at_next_start(lambda: world.agenda.after(delay, strike))
            world.executor.kill()
        elif moment == "in mid commit":
            self._random.choice(list(world.buses.values())).at_next_rpdo(strike)
        else:
            if moment != "now":
                world.planner.connection.halt()
            strike()
