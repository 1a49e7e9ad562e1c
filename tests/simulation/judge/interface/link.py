"""The planner's messages to the executor: alive in time, counts first, locks as asked, and no end without silence."""

from __future__ import annotations

import math
from collections import deque

from hyperbit.controller.program import Alive, Cancel, Clearance, Counts, Lock, Program, Question, Reset, Stop, unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Request
from tests.simulation.judge.verdict import require

ALIVE_EVERY, ALIVE_LEAST = 0.25, 0.18  # [s], awake, longest and shortest time between two
SILENT = 2.0  # [s] after which a request without an answer shows that the executor is silent
COUNTED = 0.4  # [s], awake: silence is counted in messages that the planner sends


class Link:
    """Judges what the planner sends to the executor.

    Attributes:
        timeout: of the arm's file, half the time after which a silent executor is given up [s].
    """

    def __init__(self, account: InterfaceAccount) -> None:
        self._a, self.timeout = account, math.inf
        self.begin()

    def begin(self) -> None:
        self._alive_at = self._heard_at = self._a.awake
        self._connected = self._counted = False
        self._first = True
        self._waiting = deque[object]()  # what was handed out and not sent
        self._questions: dict[int, Question] = {}

    def hears(self, greeting: bool) -> None:
        """The planner gets a message; `greeting`: the first one of a connection."""
        self._heard_at = self._a.awake
        if greeting:
            self._connected, self._counted, self._first, self._alive_at = True, False, True, self._a.awake

    def ends(self) -> None:
        self._connected = False
        self._waiting.clear()

    def sends(self, message: object) -> None:
        """A message leaves the planner's process. A stop, and a cancel of all, need not wait for those before."""
        a = self._a
        if not isinstance(message, Stop) and not (isinstance(message, Cancel) and message.program is None):
            require(bool(self._waiting), f"the planner sends {message}, which was not handed out")
            first = self._waiting.popleft()
            require(message == first, f"the planner sends {message}, before it {first} was handed out")
        elif self._waiting and message == self._waiting[0]:
            self._waiting.popleft()
        if not self._counted and isinstance(message, Counts):
            known = tuple(message.counts) == tuple(a.ledger_counts)
            require(known, f"the planner sends {message}, its ledger counts {a.ledger_counts}")
            self._counted = True
        require(self._counted, f"the planner sends {message} before its counts")
        if isinstance(message, Alive):
            apart = a.awake - self._alive_at
            soon = apart >= ALIVE_LEAST or self._first or a.lately("still", 0.3) or a.slow or a.full_lately
            require(soon, f"the planner is alive {apart:g} s after the last time")
            self._alive_at, self._first = a.awake, False

    def hands_out(self, message: object) -> None:
        """The planner hands a message to its link, which sends it at once unless the socket is full."""
        a = self._a
        if self._connected:
            self._waiting.append(message)
        match message:
            case Program(program=int(number)):
                a.sends(number)
            case Lock(actuator=k, state=state):
                wanted = a.modules.labels[k], None if state < 0 else state
                mine = [r for r in self._pending("degrade") if locks(r) == wanted]
                require(mine, f"{message}, for which nobody asked")
            case Reset():
                require(self._pending("reset"), f"{message}, for which nobody asked")
                heard = [h.snapshot.epoch for h in a.truths(math.inf) if h.snapshot is not None]
                require(message.epoch in heard or not heard, f"{message} is of an epoch that was not told: {heard[:1]}")
            case Clearance():
                self._judge_clearance(message)
            case Cancel(program=int(number)):
                ran = a.programs.get((a.instance, number))
                twice = ran is not None and ran.results and not ran.given_up
                require(not twice, f"{message} cancels a program that has a result")

    def asks(self, question: Question) -> None:
        self._questions[question.question] = question

    def _judge_clearance(self, message: Clearance) -> None:
        """Compares the answer to a question with the obstacles in force."""
        a, question = self._a, self._questions.pop(message.question, None)
        require(question is not None, f"{message} answers no question")
        assert question is not None
        before, after = unpack(question.start), unpack(question.stage)
        sets = [*a.in_force(), set(a.cubes)]
        touched = {any(cube.touched(before, after) for cube in cubes) for cubes in sets}
        failed = message.touched is not None and a.had("task failed", a.now - 5.0)
        require(failed or (message.touched is not None) in touched, f"{message} on {question} among {sets}")

    def _pending(self, key: str) -> list[Request]:
        return [r for r in self._a.requests if r.key == key and r.answer is None]

    def gives_up(self, reason: str) -> None:
        a = self._a
        silent = a.awake - self._heard_at
        keys = ("stop", "cancel", "reset", "degrade")
        owed = [r for r in a.requests if r.key in keys and r.answer is None and a.now - r.at > SILENT - 0.1]
        held_up = a.slow or a.lately("slow", 2.0) or a.lately("still", 2.0)
        require(
            held_up or silent > 2 * self.timeout - COUNTED or owed, f"the planner says that {reason} after {silent:g} s"
        )

    def tick(self) -> None:
        """Finds a planner that is not alive."""
        a = self._a
        if a.full_lately:
            return
        require(not self._waiting, f"the planner has not sent {list(self._waiting)[:3]}")
        if self._connected and a.process and not a.quits and not a.slow and not a.lately("still", 0.3):
            late = a.awake - self._alive_at
            require(late <= ALIVE_EVERY, f"the planner was not alive for {late:g} s")


def locks(request: Request) -> tuple[object, object]:
    return request.body.get("actuator"), request.body.get("state")
