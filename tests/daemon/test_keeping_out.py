"""Whatever is planned, sent and late: nothing is switched that brings a module into a region, checked independently."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.daemon.avoidance import Avoidance, Kept
from controller.daemon.events import Cancel, KeepOut, Reset
from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.obstacles.clearance import Clearance
from controller.obstacles.regions import NONE
from tests.daemon.rig import ARM, Rig, planned
from tests.obstacles.dense import Disc, regions
from tests.obstacles.moving import room, truss

PARTS = [truss("BC", 0.2, 0.2, 0.25), truss("AD", 0.2, 0.2, 0.25)]  # of ARM

configurations = st.tuples(st.integers(0, 7), st.integers(0, 7))
discs = st.builds(Disc, st.tuples(st.floats(-0.4, 0.4), st.floats(0.0, 0.6)), st.floats(0.01, 0.1))
acts = st.one_of(
    st.tuples(st.just("goal"), st.tuples(st.lists(configurations, min_size=1, max_size=4), st.booleans())),
    st.tuples(st.just("follow"), configurations),
    st.tuples(st.just("regions"), st.lists(discs, max_size=2)),
    st.tuples(st.sampled_from(["cancel", "stuck", "reset"]), st.none()),
    st.tuples(st.just("halt"), st.floats(0.01, 1.0)),
    st.tuples(st.just("go"), st.tuples(st.integers(1, 40), st.booleans())),
)


def one_by_one(plan: Plan, states: np.ndarray) -> Plan:
    """The plan with its actuators switched one after the other, from states (A,) on."""
    transitions = []
    for transition in plan.transitions:
        rows, end = [states], transition.stages[-1]
        for a in np.flatnonzero(states != end):
            rows.append(rows[-1].copy())
            rows[-1][a] = end[a]
        transitions.append(Staged(np.array(rows[1:] or rows), None))
        states = end
    return replace(plan, transitions=tuple(transitions))


class Later(Avoidance):
    """Looks when a test lets it, and that may be late."""

    def __init__(self) -> None:
        super().__init__(Kept(Clearance(ARM, NONE)))
        self._looks = list[tuple[Look, Callable[[], None]]]()

    def judge(self, states: Any, stages: Any, ended: Any = lambda *_: None) -> Any:
        look, kept = Look(), self.kept
        self._looks.append((look, lambda: ended(kept, kept.touched(states, stages))))
        return look

    def look(self) -> None:
        """Ends all looks that were begun."""
        while self._looks:
            look, end = self._looks.pop(0)
            end()
            look.ended = True


class Look:
    """A thread that is not there."""

    ended = False

    def is_alive(self) -> bool:
        return not self.ended


class Arena:
    """A rig that looks on its own at all that is switched.

    Attributes:
        shapes: what is to be kept out of.
        switched: how many stages were.
        wrong: what was, but must not have been.
    """

    def __init__(self) -> None:
        self.avoidance = Later()
        self.rig, self.shapes, self.switched = Rig(avoidance=self.avoidance), list[Disc](), 0
        self.wrong = list[str]()
        self.rig.go()
        self._commit, self._chance = self.rig.boards.commit, np.random.default_rng(0)
        self.rig.boards.commit = self.commit  # type: ignore[method-assign]

    def commit(self, states: np.ndarray, now: float) -> None:
        before, measured = self.rig.boards.outputs(), self.rig.boards.measured()
        if self.shapes and (before != states).any():
            self.wrong += ["what was switched before has not settled"] * (self.rig.boards._pending is not None)
            moving = (before != states) | (measured != states)  # what stuck may come free
            corners = np.array(list(product((0.0, 1.0), repeat=int(moving.sum()))))
            strokes = np.tile(before.astype(float), (len(corners) + 20, 1))
            strokes[:, moving] = np.concatenate([corners, self._chance.random((20, int(moving.sum())))])
            away, _ = room(PARTS, ARM.base, self.shapes, strokes, 100, pairs=False)  # type: ignore[arg-type]
            self.wrong += [f"{before} to {states} goes {-away:.4f} deep into {self.shapes}"] * (away < 0)
            self.switched += 1
        self._commit(states, now)

    def goal(self, name: str, chosen: list[tuple[int, int]], apart: bool) -> None:
        plan = planned(*chosen)
        plan = one_by_one(plan, self.rig.boards.outputs()) if apart else plan
        goal = replace(self.rig.goal(name, *chosen), plan=plan, kept=self.avoidance.kept)
        self.rig.loop.inbox.hand_over(goal)

    def keep_out(self, shapes: list[Disc]) -> None:
        sent = regions(shapes)  # type: ignore[arg-type]

        def told(_: object) -> None:
            self.shapes = shapes

        self.rig.loop.inbox.hand_over(KeepOut(self.rig.arrival(), told, Kept(Clearance(ARM, sent), sent)))
        while self.shapes is not shapes:
            self.rig.go()

    def reset(self) -> None:
        self.rig.boards.stuck = False
        self.rig.request(Reset)

    def go(self, ticks: int, prompt: bool = True) -> None:
        """Lets time pass; no look ends meanwhile unless they are prompt."""
        for _ in range(ticks):
            self.rig.go()
            if prompt:
                self.avoidance.look()


def play(sequence: list[tuple[str, Any]]) -> Arena:
    arena = Arena()
    for number, (act, argument) in enumerate([*sequence, ("go", (60, True))]):
        match act:
            case "goal":
                arena.goal(f"goal {number}", *argument)
            case "follow":
                arena.rig.follow(arena.rig.arrival(), argument)
            case "regions":
                arena.keep_out(argument)
            case "cancel":
                arena.rig.request(Cancel)
            case "stuck":
                arena.rig.boards.stuck = True
            case "reset":
                arena.reset()
            case "halt":
                arena.rig.now += argument
            case "go":
                arena.go(*argument)
    arena.reset()
    arena.go(60)
    assert arena.wrong == []
    assert arena.rig.loop.mode == "ready", arena.rig.loop.reason
    return arena


@settings(max_examples=100)
@given(st.lists(acts, max_size=20))
def test_whatever_happens_nothing_is_switched_into_a_region(sequence: list[tuple[str, Any]]) -> None:
    arena = play(sequence)
    goals = [reply for _, reply in arena.rig.replies if reply["accepted"] and "id" in reply]
    told = [name for name, _ in arena.rig.results]
    assert sorted(told) == sorted(reply["id"] for reply in goals if reply["id"] in told)


def test_that_much_is_switched_among_regions() -> None:
    arena = play([("regions", [Disc((0.4, 0.5), 0.05)]), *[("goal", ([(1, 2), (7, 0)], True)), ("go", (60, True))] * 3])
    assert arena.switched >= 6
