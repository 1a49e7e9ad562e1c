"""Progress and remaining time of a goal: what `state` and `feedback` tell, compared with the world."""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Ran
from tests.simulation.judge.verdict import require

ROUNDED = 0.07  # [s] times in `progress` have one decimal; the planner hears of a stage a moment after its begin


class Progress:
    """Judges what is told of a goal while it runs, and at its end whether its end was foretold."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self._foretold = WeakKeyDictionary[Ran, list[float]]()  # expected ends [s]
        self._reached = WeakKeyDictionary[Ran, int]()
        self._least = WeakKeyDictionary[Ran, int]()  # by the feedback that was told before the last state

    def state(self, ran: Ran | None, payload: Payload) -> None:
        a, told = self._a, payload["progress"]
        text = f"state tells the progress {told}"
        require((ran is None) == (told is None), f"{text} of {None if ran is None else ran.goal}")
        if ran is None or told is None:
            return
        count = 1 if ran.jog else None if ran.request is None else len(ran.request.body["waypoints"])
        require(count in (None, told["waypoints"]), f"{text}; the goal has {count} waypoints")
        least = self._least.get(ran, 0)
        self._least[ran] = 0 if ran.jog else 1 + max((it["waypoint"] for it in ran.feedback), default=-1)
        most = 0 if ran.jog else 1 + max(map(ran.waypoint, ran.settled), default=-1)
        require(least <= told["reached"] <= most <= told["waypoints"], f"{text}; {least} to {most} are reached")
        require(told["reached"] >= self._reached.get(ran, 0), f"{text}, before {self._reached.get(ran)} were reached")
        self._reached[ran] = told["reached"]
        require(told["begins"] <= told["ends"], f"{text}: it ends before it begins")
        require(all(round(told[name], 1) == told[name] for name in ("begins", "ends")), f"{text}: more decimals")
        if not a.lately("clock", DELAY):
            self._foretell(ran, told["ends"] - a.wall())

    def feedback(self, ran: Ran, payload: Payload) -> None:
        require(payload["remaining"] >= 0, f"feedback {payload}: the remaining time is negative")
        self._foretell(ran, payload["remaining"])

    def _foretell(self, ran: Ran, remaining: float) -> None:
        """Compares an expected end with the times that the executor got, which it never undercuts."""
        end, earliest = self._a.now + remaining, _planned_end(ran)
        require(end >= earliest - ROUNDED, f"{ran.goal} is told to end at {end}, it cannot be before {earliest}")
        self._foretold.setdefault(ran, []).append(end)

    def result(self, ran: Ran) -> None:
        """Judges the ends that were foretold of a goal that has succeeded. A goal that waits ends later."""
        foretold = self._foretold.pop(ran, [])
        latest = max(foretold, default=0.0)
        early, late = latest - ran.ended_at, latest > _planned_end(ran) + ROUNDED
        most = ROUNDED + late * self._a.lead * len(ran.program.stages)  # a late arm catches up
        require(ran.replaced or early <= most, f"{ran.goal} ended {early:g} s before the end that was told")


def _planned_end(ran: Ran) -> float:
    """Returns the end of a program by its own times; minus infinity if they are not known, or were replaced."""
    if ran.replaced or not ran.program.stages:
        return -math.inf
    return (ran.program.begin or ran.at) + max(max(it.at, it.settled) for it in ran.program.stages)
