"""Statements on results, plans and feedback: they are what the arm did, and what was possible."""

from __future__ import annotations

import math
import re
from itertools import pairwise

from hyperbit.controller.program import Ended, Program, Settled, unpack
from tests.simulation.statements.asked import Payload, Ran, Request, states_from
from tests.simulation.statements.clients import RECONNECTED, OfClients
from tests.simulation.statements.exchange import Exchange
from tests.simulation.statements.mechanics import NEAR, SLACK, Mechanics, apart_of, shifted

CODES = {"succeeded": 0, "canceled": -1, "replaced": -1, "aborted": -4, "lost": -4}
MISSED = -5  # code of a goal that was done and is not reached
SWITCHES = re.compile(r", (\d+) switch")
UNREACHED = re.compile(r"waypoint (\d+), ")  # begin of a refusal that a search has proven
ROUNDED = 0.07  # [s]: foretold times have one decimal; the planner hears of a stage a moment after its begin


class OfTheArm(OfClients):
    """A statement over results, with the mechanics of the arm."""

    def __init__(self, exchange: Exchange, mechanics: Mechanics) -> None:
        super().__init__(exchange)
        self.mechanics = mechanics

    def pose(self, payload: Payload, told: Settled | Ended, text: str) -> None:
        """Compares configuration, position and orientation with measured states, by own forward kinematics."""
        tip = self.mechanics.tips.get(self.mechanics.code(told.known, told.measured))
        if tip is None:
            self.require(payload["configuration"] is None and payload["position"] is None, text)
            return
        self.require(payload["configuration"] == tip.notation, lambda: f"{text}; measured is {tip}")
        self.require(tip.near(payload), lambda: f"{text}; the tip is at {tip}")

    def error(self, payload: Payload, request: Request, waypoint: int, text: str) -> None:
        """Compares the errors with a waypoint, of the pose that a payload tells."""
        wanted, text = request.body["waypoints"][waypoint], f"{text}; waypoint {waypoint}"
        if payload["position"] is None:
            self.require(payload["error"] is None and payload["orientation_error"] is None, text)
            return
        fixed = "configuration" in wanted
        at = tuple(payload["position"]) if fixed else shifted(payload["position"], payload.get("bias"))
        error = math.dist(at, self.mechanics.place(wanted))
        told = payload["error"] is not None and abs(payload["error"] - error) < NEAR
        self.require(told, lambda: f"{text} is {error} away")
        turned, angle = self.mechanics.turned(request, wanted), payload["orientation_error"]
        self.require((angle is None) == (turned is None), lambda: f"{text} is {wanted}")
        if turned is not None and angle is not None:
            right = abs(angle - apart_of(payload["orientation"], turned)) < NEAR
            self.require(right, lambda: f"{text} is {wanted}")


class ResultsAreTrue(OfTheArm):
    """`succeeded`: the measured states are the goal, its tip is within the tolerance; each result tells the truth."""

    number = 4
    least = 700

    def ends(self, ran: Ran, payload: Payload) -> None:
        text, ended, request = f"result {payload}", ran.ended, ran.request
        status, missed = payload["status"], payload["code"] == MISSED
        self.require(missed or payload["code"] == CODES[status], text)
        if ended is None or status == "lost":
            known = [payload[name] for name in ("configuration", "position", "error")]
            self.require(status in ("lost", "aborted") and known == [None] * 3, lambda: f"{text}; {ended} was told")
            return
        self.require(payload["switches"] == ended.switches, lambda: f"{text}; the executor tells {ended}")
        done = ended.status == "done"
        self.require(done if status == "succeeded" or missed else not done or status == "aborted", text)
        self.pose(payload, ended, text)
        if request is not None and (status == "succeeded" or missed):
            reached = self._reached(request, ran, ended, payload)
            self.require(reached == (status == "succeeded"), lambda: f"{text}; reached: {reached}")
        if request is None or ran.jog or ran.process != self.exchange.process:
            return
        if not request.lined:
            self.error(payload, request, max(ran.mark, 0), text)
        if not ran.replaced and ran.planned is not None:
            self.require(payload["planned_switches"] == ran.planned, lambda: f"{text}; planned are {ran.planned}")

    def accepts(self, ran: Ran) -> None:
        """Each mark is at a configuration that serves its waypoint."""
        request = ran.request
        if request is None or ran.jog or request.lined or ran.start is None or self.exchange.erred(request.at):
            return
        wanted = self.mechanics.serving(request, (self.exchange.state or {}).get("bias"))
        for code, mark in codes_of(ran):
            self.require(mark < 0 or code in wanted[mark], lambda: f"{ran.program} for {request}: {code:b}, {mark}")  # noqa: B023

    def answered(self, request: Request, answer: Payload) -> None:
        """The switches that an answer tells are those of the stages from where the goal is planned: where the arm is.

        The executor counts from its outputs. A jog begins there, too.
        """
        if request.key not in ("goal", "jog") or not answer["accepted"]:
            return
        ran, words = self.exchange.ran(answer["id"])[-1], SWITCHES.search(answer["message"])
        self.require(words is not None, lambda: f"{request} is answered by {answer}")
        if words is not None and ran.request is request and ran.program.final:
            ran.planned = int(words[1])
            if ran.start is not None:
                start, locked = ran.start
                begin = unpack(ran.program.start) if ran.jog else start
                right = ran.planned == switches_of(ran.program, begin, locked)
                self.require(right, lambda: f"{request}: {answer}, {ran.program}, planned from {begin:b}")

    def _reached(self, request: Request, ran: Ran, ended: Ended, payload: Payload) -> bool:
        known, measured = unpack(ended.known), unpack(ended.measured)
        if not ran.jog:
            serving = self.mechanics.serving(request, payload.get("bias"))[-1]
            return self.mechanics.code(ended.known, ended.measured) in serving
        asked = {self.mechanics.labels.index(label): state for label, state in request.body["actuators"].items()}
        return all(known >> k & 1 and measured >> k & 1 == (state == "extended") for k, state in asked.items())


class MarksComeInOrder(OfTheArm):
    """Feedback tells each mark that has settled once, in order, with its numbers; times are foretold truly."""

    number = 13
    least = 1500

    def feedback(self, payload: Payload) -> None:
        ran, text = self.exchange.ran_now(payload["id"]), f"feedback {payload}"
        self.require(ran is not None, lambda: f"{text}, and no such goal runs")
        if ran is None or ran.request is None:
            return
        last = ran.feedback[-1]["waypoint"] if ran.feedback else -1
        count = len(ran.request.body["waypoints"])
        in_order = last < payload["waypoint"] < payload["waypoints"] == count
        self.require(in_order, lambda: f"{text} after waypoint {last}")
        if ran.request.lined:
            return
        settled = ran.told.get(payload["waypoint"])
        self.require(settled is not None, lambda: f"{text}, and the executor has told no such mark")
        if settled is not None:
            stages = sum(s.stages for mark, s in ran.told.items() if last < mark <= payload["waypoint"])
            numbers = payload["switches"], payload["stages"]
            self.require(numbers == (settled.switches, stages), lambda: f"{text}; the executor tells {settled}")
            self.pose(payload, settled, text)
            self.error(payload, ran.request, payload["waypoint"], text)
        self._foretell(ran, self.account.now + payload["remaining"], text)

    def state(self, payload: Payload) -> None:
        ran, told = self.exchange.ran_now(payload["goal"]), payload["progress"]
        text = f"state tells of {payload['goal']} {told}"
        self.require((told is None) == (payload["goal"] is None), text)
        if ran is None or told is None:
            return
        count = 1 if ran.jog or ran.request is None else len(ran.request.body["waypoints"])
        if ran.request is not None and not ran.request.lined:
            least, most = ran.reached, 0 if ran.jog else 1 + max(ran.told, default=-1)
            ran.reached = max([0, *(feedback["waypoint"] + 1 for feedback in ran.feedback)])
            self.require(least <= told["reached"] <= most, lambda: f"{text}; {least} to {most} are reached")
            self.require(told["waypoints"] == count, text)
        if not self.exchange.happened("clock", ran.at):
            self._foretell(ran, told["ends"] - self.exchange.wall() + self.account.now, text)

    def _foretell(self, ran: Ran, end: float, text: str) -> None:
        """An end that is foretold is never before the program's own times, and no goal ends before it.

        After a halt the planner hears late, and tells late: then the goal may have ended.
        """
        if not ran.replaced and ran.program.stages:
            earliest = (ran.program.begin or ran.at) + max(max(it.at, it.settled) for it in ran.program.stages)
            self.require(end >= earliest - ROUNDED, lambda: f"{text}; it ends at {end}, not before {earliest}")
            late = self.exchange.happened("halt", min(ran.at, self.account.now - RECONNECTED)) or self.exchange.quits
            if not late and not self.exchange.hindered:
                ran.foretold.append(end)

    def ends(self, ran: Ran, payload: Payload) -> None:
        if ran.process != self.exchange.process:
            return
        if ran.request is not None and not ran.jog and not ran.request.lined and payload["status"] != "lost":
            left = ran.told.keys() - {feedback["waypoint"] for feedback in ran.feedback}
            self.require(not left, lambda: f"result {payload} comes without the feedback of {left}")
        if payload["status"] == "succeeded" and not ran.replaced and ran.program.stages:
            late = len(ran.program.stages) * self.exchange.lead  # a late arm catches up
            early = max(ran.foretold, default=0.0) - ran.ended_at
            self.require(early <= ROUNDED + late, lambda: f"{ran.goal} ended {early:g} s before the end that was told")


class BoundsAreTrue(OfTheArm):
    """`optimal` is what listing all configurations says, and a bound is never above it."""

    number = 15
    least = 150

    def ends(self, ran: Ran, payload: Payload) -> None:
        if payload.get("lower_bound") is None:
            return
        text = f"result {payload}"
        as_planned = payload["status"] == "succeeded" and payload["planned_switches"] == payload["switches"]
        self.require(as_planned and payload["optimal"] == (payload["certificate"] == "optimal"), text)
        if ran.request is None or ran.request.lined or ran.start is None:
            return
        wanted = self.mechanics.serving(ran.request, payload.get("bias"))
        start, locked = ran.start
        least = self.mechanics.least(start, locked, ran.among, wanted)
        self.require(payload["lower_bound"] <= least + SLACK, lambda: f"{text}; a way from {start:b} costs {least}")
        if payload["optimal"] and self.mechanics.uniform and unpack(ran.program.start) == start:
            self.require(payload["switches"] <= least + SLACK, lambda: f"{text}; {least} switches are possible")

    def answered(self, request: Request, answer: Payload) -> None:
        """A plan is judged if one snapshot and the same obstacles held from its query to its answer.

        What is refused as out of reach is that.
        """
        refused = UNREACHED.match(answer["message"]) if answer.get("reason") == "out-of-reach" else None
        judged = (request.key == "plan" and answer["accepted"]) or (refused and request.key in ("plan", "goal"))
        if not judged or request.lined or "bias" in (self.exchange.state or {}):
            return
        heard = list(self.exchange.lately(self.exchange.awake - request.awake))
        starts = {(s.measured, s.known, s.outputs, s.locked, s.moving) for s in heard if s is not None}
        rests = len(starts) == 1 and None not in heard and not self.exchange.running
        if not rests or not self.exchange.kept_obstacles(request.at):
            return
        snapshot = heard[0]
        assert snapshot is not None
        start = states_from(snapshot)
        wanted = self.mechanics.serving(request, None)
        locked = unpack(snapshot.locked)
        if refused:
            clear = self.mechanics.clear(start, locked, self.exchange.confirmed) & wanted[int(refused[1]) - 1]
            self.require(not clear, lambda: f"{request} is answered by {answer}; it is reached in {sorted(clear)}")
            return
        known = start, locked, self.exchange.confirmed, wanted
        least, sure = self.mechanics.least(*known), self.mechanics.least(*known, between=True)
        text = f"{request} is answered by {answer}; the least cost is {least}, in between {sure}"
        self.require((answer["lower_bound"] or 0.0) <= least + SLACK and sure <= answer["cost"] + SLACK, text)
        optimal = answer["certificate"] == "optimal"
        self.require(bool(answer["optimal"]) == optimal and (not optimal or math.isclose(answer["cost"], least)), text)


def codes_of(ran: Ran) -> list[tuple[int, int]]:
    """Returns actuator states and mark of each stage of a program whose start is known."""
    assert ran.start is not None
    start, locked = ran.start
    return [(unpack(stage.states) & ~locked | start & locked, stage.mark) for stage in ran.program.stages]


def switches_of(program: Program, start: int, locked: int) -> int:
    """Returns the number of switches of a program's stages from a state; locked actuators do not switch."""
    states = [start, *(unpack(stage.states) for stage in program.stages)]
    return sum(((before ^ after) & ~locked).bit_count() for before, after in pairwise(states))
