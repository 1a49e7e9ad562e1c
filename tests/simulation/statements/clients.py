"""Statements on requests: each has one true answer, a stop bars what came before it, each goal has one result."""

from __future__ import annotations

import re
from pathlib import Path

from hyperbit.controller.executor.core.events import Event, FromClient
from hyperbit.controller.program import Acknowledge, Cancel, Hello, Setpoint, Stop
from tests.simulation.statements.asked import Payload, Ran, Request
from tests.simulation.statements.exchange import PAUSE, SAME, Exchange
from tests.simulation.statements.motions import Switch
from tests.simulation.statements.statement import Statement

PAGE = Path(__file__).parents[3] / "controller" / "refusals" / "README.md"
STARVED = "no further stages"  # in the result of a program that has waited for them in vain
EXECUTOR_WITHIN = 3.0  # [s] for the executor's answer, and the ledger's
AT_ONCE = 1.0  # [s] for what the planner's process knows
OBSTACLES_WITHIN = 6.0  # [s] for what waits until a silent executor counts as lost
RECONNECTED = 7.0  # [s] after a standstill, in which results wait for clients, and answers behind them
REMEMBERED = 2.0  # [s] after a stop in which statement 2 is armed
LOOK_EVERY = 0.1  # [s]


class OfClients(Statement):
    """A statement over what clients and the daemon tell each other."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__(exchange.account)
        self.exchange = exchange


class NothingBeginsAfterAClientsStop(OfClients):
    """After the answer to a stop or cancel nothing begins, and no pin changes, for what a client asked before it."""

    number = 2
    least = 40

    def accepts(self, ran: Ran) -> None:
        if ran.request is not None:
            self._judge(ran.request.number, ran.goal, f"{ran.request} begins")

    def switches(self, switch: Switch) -> None:
        if switch.cause != "SYNC" or switch.sync is None or not switch.sync.asked:
            return
        motion = max((motion for motion, _ in switch.sync.asked), key=lambda motion: motion.order)
        if isinstance(motion.message, Setpoint):
            self._judge(self.exchange.stream_began, None, f"{switch.mask:b} switch for set-points")
            return
        ran = self.exchange.programs.get((self.exchange.instance, motion.message.program))
        if ran is not None and ran.request is not None:
            self._judge(ran.request.number, ran.goal, f"{switch.mask:b} switch for {ran.request}")

    def _judge(self, number: int, goal: str | None, text: str) -> None:
        for barrier in self.exchange.barriers:
            if barrier.at > self.account.now - REMEMBERED and barrier.goal in (None, goal):
                allowed = number > barrier.number or barrier.answered_at >= self.account.now
                self.require(allowed, lambda barrier=barrier: f"{text} after the answer to {barrier}")  # type: ignore[misc]


class EachGoalHasOneResult(OfClients):
    """Each accepted goal has exactly one result, also over kills, while clients are there; a refused one has none."""

    number = 3
    least = 300

    def __init__(self, exchange: Exchange) -> None:
        super().__init__(exchange)
        self._kept: dict[Ran, tuple[str, int, str, float]] = {}

    def planner_begins(self) -> None:
        """What the ledger has of a result stays, whatever comes again."""
        for ran in self.exchange.programs.values():
            if (row := self.exchange.recorded(ran)[1]) is not None:
                kept = self._kept.setdefault(ran, row)
                self.require(row == kept, lambda: f"the ledger has {row} of {ran.goal}; it had {kept}")  # noqa: B023

    def answered(self, request: Request, answer: Payload) -> None:
        if request.key in ("goal", "jog") and answer["accepted"]:
            alike = (r.at for r in self.exchange.requests if r.sent is not None and r.sent == request.sent)
            first = min(alike, default=request.at)  # whose answer may be lost
            ran = [ran for ran in self.exchange.ran(answer["id"]) if ran.result_at > first]
            self.require(ran, lambda: f"{request} is accepted, and no executor has it")
        elif request.key == "result" and answer.get("result"):
            told = [one.results[0]["status"] for one in self.exchange.ran(answer["result"]["id"]) if one.results]
            right = answer["result"]["status"] in told
            self.require(right, lambda: f"{request} is answered by {answer}; {told} were told")

    def result(self, payload: Payload) -> None:
        if payload["status"] == "refused":
            puts = [r for r in self.exchange.requests if not r.query and r.answer is None]
            fits = [r for r in puts if payload["id"] in (None, r.goal) or r.goal is None]
            self.require(fits, lambda: f"result {payload}, and no put waits")
            return
        exchange, ran, text = self.exchange, self.exchange.ran_of(payload), f"result {payload}"
        self.require(ran is not None, lambda: f"{text}, and no such goal was accepted")
        if ran is None:
            return
        if not exchange.quits:
            late = exchange.alone_until if ran.process == exchange.process else exchange.reached_from
            self.require(self.account.now >= late, lambda: f"{text} leaves before clients are connected again")
        if ran.results:
            first = ran.results[0]
            same = all(first[name] == payload[name] for name in ("status", "code"))
            self.require(payload.get("repeated") and same, lambda: f"{text} is told again, after {first}")
        elif payload.get("repeated"):  # an earlier process had marked it, and may not have sent it
            self.require(self.exchange.happened("planner", ran.at), lambda: f"{text}, for the first time")

    def told(self, event: Event) -> None:
        """A result is acknowledged only after it was published and recorded; while the disk was full, not recorded."""
        match event:
            case FromClient(_, Acknowledge(result)):
                mine = [ran for ran in self.exchange.programs.values() if ran.instance == self.exchange.instance]
                for ran in [ran for ran in mine if ran.ended is not None and ran.ended.result == result]:
                    accepted, recorded = self.exchange.recorded(ran)
                    told = ran.results and (recorded or self.exchange.disk_was_full(ran.at))
                    self.require(told or not accepted, f"the result of {ran.goal} is acknowledged; told: {ran.results}")

    def told_all(self) -> None:
        self.planner_begins()
        for ran in self.exchange.programs.values():
            accepted, recorded = self.exchange.recorded(ran)
            if accepted or (ran.request is not None and ran.request.accepted):
                self.require(ran.results, lambda ran=ran: f"{ran.goal} was accepted, and has no result")  # type: ignore[misc]
                told = [(one["status"], one["code"], one["message"]) for one in ran.results]
                right = told and recorded is not None and recorded[:3] == told[0]
                self.require(right, f"the ledger tells of {ran.goal}: {recorded}; its results are {ran.results}")


class EachRequestHasOneAnswer(OfClients):
    """Each request has one answer in time; what was drawn in calm is accepted or refused as it was drawn.

    Time does not count while the process stands still, or while network, disk, socket or workers may delay answers.
    """

    number = 11
    least = 800

    def __init__(self, exchange: Exchange) -> None:
        super().__init__(exchange)
        self._looked, self._awake, self._reasons = 0.0, 0.0, reasons_on_the_page()

    def answered(self, request: Request, answer: Payload) -> None:
        text = f"{request} is answered by {answer}"
        self.require(request.answer is None, lambda: f"{text} again, after {request.answer}")
        if request.key == "arm" and "accepted" not in answer:
            return
        if answer["accepted"]:
            self.require(answer["code"] == 0 and answer["message"], text)
        else:
            code, sentence = self._reasons[answer["reason"]]
            self.require(answer["code"] == code and sentence.fullmatch(answer["message"]), text)
        if request.drawn:
            told = "accepted" if answer["accepted"] else answer["reason"]
            self.require(told in request.drawn, lambda: f"{text}; it was drawn as {request.drawn}")

    def steps(self) -> None:
        if self.account.now < self._looked + LOOK_EVERY:
            return
        passed, self._looked, self._awake = self.exchange.awake - self._awake, self.account.now, self.exchange.awake
        if self.exchange.hindered or self.exchange.happened("standstill", self.account.now - RECONNECTED):
            return
        for request in self.exchange.unanswered():
            request.waited, longest = request.waited + passed, longest_of(request)
            self.require(request.waited <= longest, lambda r=request: f"{r} has no answer after {r.waited:g} s")  # type: ignore[misc]

    def ends_in_order(self) -> None:
        left = [str(request) for request in self.exchange.unanswered()]
        self.require(not left, lambda: f"the process has ended without the answers to {left}")


class MessagesKeepTheirOrder(OfClients):
    """The executor takes the planner's messages in the order of sending, none twice; stops and cancels may overtake."""

    number = 13
    least = 250

    def told(self, event: Event) -> None:
        match event:
            case FromClient(_, Hello() | Stop() | Cancel(program=None)):
                pass
            case FromClient(client, message) if client == self.account.planner:
                sent = self.exchange.sent.get(client)
                next_one = sent.popleft() if sent else None
                self.require(next_one == message, lambda: f"{message} comes to the executor before {next_one}")


class OnlyFreshSetpointsAreFollowed(OfClients):
    """A stream is followed only as long as set-points come that are not stale."""

    number = 11
    least = 80

    def told(self, event: Event) -> None:
        match event:
            case FromClient(client, Setpoint(until=until)) if client == self.account.planner:
                longest = self.exchange.fresh_at + PAUSE
                self.require(until <= longest + SAME, f"set-points are followed until {until}, fresh ones to {longest}")


class CalmMeansReady(OfClients):
    """In calm the arm is ready, a simple goal succeeds, and no goal waits for stages in vain."""

    number = 10
    least = 20

    def ends(self, ran: Ran, payload: Payload) -> None:
        if self.account.clear and ran.ended is not None:
            self.require(STARVED not in ran.ended.message, lambda: f"{ran.program} is not fed: {ran.ended}")

    def tried(self, result: Payload) -> None:
        self.require(result["status"] == "succeeded", lambda: f"a simple goal ends as {result}")


class OneFaultIsTold(OfClients):
    """One fault in calm: exactly its row of the table is told. `one_fault` waits for its begin and its end."""

    number = 16
    least = 20

    def __init__(self, exchange: Exchange) -> None:
        super().__init__(exchange)
        self._expected: set[str] | None = None  # codes; None: nothing was broken

    def breaks(self, expected: set[str]) -> None:
        self._expected = expected

    def is_mended(self) -> None:
        self._expected = None

    def state(self, payload: Payload) -> None:
        if self._expected is not None:
            others = {fault["code"] for fault in payload["faults"]} - self._expected
            self.require(not others, lambda: f"{others} are told, expected are {self._expected}")


class NoInternalError(OfClients):
    """There is no internal error, and no traceback."""

    number = 18
    least = 250

    def planner_logs(self, text: str) -> None:
        self.require("Traceback" not in text, text)

    def answered(self, request: Request, answer: Payload) -> None:
        self.require(answer.get("reason") != "internal-error", lambda: f"{request} is answered by {answer}")


def longest_of(request: Request) -> float:
    """Returns how long a request may wait for its answer [s]."""
    match request.key:
        case "goal" | "jog":
            return request.patience + EXECUTOR_WITHIN
        case "obstacles" | "plan":
            return OBSTACLES_WITHIN
        case "arm" | "result" | "poses":
            return AT_ONCE
        case _:
            return EXECUTOR_WITHIN


def reasons_on_the_page() -> dict[str, tuple[int, re.Pattern[str]]]:
    """Returns code and sentence of each reason in the page's table; facts in the sentence match anything."""
    found = {}
    for row in PAGE.read_text().splitlines():
        if match := re.match(r"\| `([a-z0-9-]+)`(?: (-\d+))? \| (.*?) \| ", row):
            words = re.sub(r"\\\{[^}]*\\\}", ".*", re.escape(match[3]))
            found[match[1]] = int(match[2] or -1), re.compile(words, re.DOTALL)
    return found
