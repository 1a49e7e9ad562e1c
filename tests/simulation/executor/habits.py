"""What the executor's process does beside its core: figures of its loop, systemd's watchdog, faults to play."""

from __future__ import annotations

from random import Random

from hyperbit.controller.executor.core.events import Event, FaultPlayed, Health, ToSimulation
from hyperbit.controller.program import FaultVerb, PlayableFaults

BEAT = 0.4  # [s], the watchdog time of the simulated unit
VERB = FaultVerb("silence", "board", "", "the board sends nothing")
PLAYABLE = PlayableFaults((VERB,), ("can0/1",), ("can0",), ())
PLAYED = "done: it is played"


class Habits:
    """The drawn habits of the processes of one world.

    Attributes:
        watchdog: systemd's watchdog time [s]; None without a watchdog.
        simulation: faults that can be played in the boards; None: the boards count as real.
        problem: what is wrong with the switch journal; None: nothing.
    """

    def __init__(self, random: Random) -> None:
        self.watchdog = random.choice([None, BEAT])
        self.simulation = random.choice([None, PLAYABLE])
        self.problem: str | None = None
        self.dropped = 0
        self._random = random

    def figures(self) -> Event | None:
        """Returns the figures that the loop passes to its core, or None if it is too late for them."""
        if self._random.random() < 0.1:
            return None
        loop = {"ticks": self._random.randint(1, 100), "late_worst": self._random.random()}
        return Health(loop, self.dropped, self.problem)

    def play(self, action: ToSimulation) -> FaultPlayed:
        """Returns whether a fault was played; the simulated boards of this world play none of them."""
        played = self._random.random() < 0.5
        text = PLAYED if played else f"there is no fault {action.fault}"
        return FaultPlayed(action.client, action.request, text, played)
