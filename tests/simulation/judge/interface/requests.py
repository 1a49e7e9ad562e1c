"""Requests: each has one true answer in time, and takes effect in the order of arrival, or not at all."""

from __future__ import annotations

import re
from collections.abc import Callable

from hyperbit.controller.program import Program, unpack
from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.answers import judge_homing, judge_jog
from tests.simulation.judge.interface.asked import barring, ends_at, lined, patience
from tests.simulation.judge.interface.facts import Payload, Ran, Request
from tests.simulation.judge.interface.locks import leaves_states
from tests.simulation.judge.interface.messages import well_formed
from tests.simulation.judge.interface.plans import judge_plan
from tests.simulation.judge.interface.refusals import judge_refusal
from tests.simulation.judge.verdict import require

EXECUTOR_ANSWERS = 3.0  # [s], awake: the planner gives an executor up after 2 s without an answer
SLOW_PEER = 0.15  # [s] that an answer waits for a peer that reads slowly, for each answer before it
ANSWERED_WITHIN = {  # [s], awake, from the arrival to the answer
    **dict.fromkeys(("stop", "cancel", "reset", "degrade", "fault"), EXECUTOR_ANSWERS),
    **dict.fromkeys(("arm", "result", "poses"), 1.0),
    "obstacles": 6.0,  # 5 s for the checks, see the page
    "plan": 75.0,  # five plans of 10 s, one after the other, with the worker's delays
}
ALONE = 0.2  # [s], awake, from the loss of the executor, or a later request, to its refusal
WRITTEN_WITHIN = 1.0  # [s] from the acceptance to the answer: the ledger is written between them
LATE = 1.2  # [s]: a process that stood still for less than 1 s does not know it; and the network
SOON = 2.5  # [s], awake, from the arrival of a goal to its answer if nothing stands in its way
ENDS_WITHIN = 3.0  # [s] from the answer to a cancel to the end of what it ended
SHOWN_WITHIN = 0.3  # [s], awake, from the answer to other obstacles to a state with another number
LOCKED_WITHIN = 0.3  # [s], awake, from the answer to a lock to a snapshot that has it
RUNS = ("ready", "executing")
REMEMBERED = 60.0  # [s] for which a goal with an attachment is recognized
ENDED_LATELY = 7.0  # [s] after a result, in which a payload may still be recognized: the result waits for clients
STAMPED_WITHIN = 0.1  # [s] from the check of a stamp to the acceptance by the executor
HOMING = r"(?:; before them (?P<homed>\d+) switch(?:es)? homes? actuators of unknown position: .*?)?"
UNCHECKED = (
    r"(?:; collisions of the homing were not checked, because it is not known where (?P<unchecked>.*) (?:is|are))?"
)
WORDS = re.compile(rf"accepted, (\d+) waypoints?, (\d+) switch(?:es)? planned{HOMING}{UNCHECKED}")
JOG_WORDS = re.compile(r"accepted, (\d+) switch(?:es)?: .*")
ENDED_BY_CANCEL = {"canceled before it began": ("goal", "jog"), "the plan is canceled": ("plan",)}
OBSTACLES = re.compile(r"(\d+) obstacles?, (\d+) of them sent.*", re.DOTALL)


class Requests:
    """Judges answers, and what begins.

    Attributes:
        barred: takes each stop and cancel with its answer.
    """

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self.barred: Callable[[Request], None] = lambda request: None
        self._claims: list[tuple[float, Callable[[], None]]] = []  # judged when the process was awake so long
        self.begin()

    def begin(self) -> None:
        self._barriers: list[Request] = []
        self._claims.clear()

    def arrives(self, request: Request) -> None:
        """Records a request, and which one it repeats."""
        a = self._a
        a.requests.append(request)
        if request.key in ("goal", "jog"):
            a.note("motion asked")
        if request.key == "goal" and "*" not in request.name:
            self._find_original(request)
            request.doubtful |= request.original is not None and not well_formed(request, a.modules)

    def _find_original(self, request: Request) -> None:
        """Finds the goal that a request repeats: same payload and attachment, or same payload with an id."""
        a = self._a
        goals = [r for r in reversed(a.requests[:-1]) if r.key == "goal" and r.payload == request.payload]
        others = [r for r in goals if "*" not in r.name and r.original is None]
        attached = [r for r in others if request.attachment and r.attachment == request.attachment]
        request.original = next((r for r in attached if a.now - r.at < REMEMBERED - 1.0), None)
        for other in others if request.original is None else []:
            over = other.answer is not None and not other.accepted
            ran = next((ran for ran in a.programs.values() if ran.request is other), None)
            told = ran is not None and bool(ran.results)
            lately = ran is not None and a.now - ran.ended_at < ENDED_LATELY
            if request.goal is not None and not (over or told):
                request.original = other
                request.doubtful = ran is not None and ran.ended is not None
            elif (
                other in attached or (lately and request.goal is not None) or (over and a.now - other.answered_at < 0.1)
            ):
                request.original, request.doubtful = other, True
            if request.original is not None:
                return

    def answers(self, request: Request, answer: Payload) -> None:
        a = self._a
        require(request.answer is None, f"{request} is answered again: {answer}")
        request.answer, request.answered_at = answer, a.now
        if request.key in ("goal", "jog"):
            a.note("answered")
        if request.key == "arm" and "accepted" not in answer:
            return
        text = f"the answer to {request}: {answer}"
        if request.key == "poses":
            return
        form = isinstance(answer.get("accepted"), bool) and isinstance(answer.get("code"), int)
        require(form and answer.get("message"), f"{text} lacks accepted, code or message")
        if self._repeats(request, answer):
            return
        if not answer["accepted"]:
            request.answer = None
            judge_refusal(a, request, answer)
            request.answer = answer
            return
        require(answer["code"] == 0, f"{text} has code {answer['code']}")
        require(well_formed(request, a.modules), f"{text}; it is malformed")
        match request.key:
            case "goal" | "jog":
                self._begins(request, answer, text)
            case "stop" | "cancel" | "reset":
                self._bars(request, answer, text)
            case "obstacles":
                self._take_obstacles(request, answer, text)
            case "degrade":
                self._locks(request)
            case "result":
                self._judge_result(request, answer)
            case "fault":
                require(a.simulated, f"{text}; the boards are real")
            case "plan":
                judge_plan(a, request, answer, text)

    def _repeats(self, request: Request, answer: Payload) -> bool:
        """Returns whether a request got the answer of the one that it repeats."""
        original = request.original
        if original is None:
            return False
        known = original.answer
        if known is not None and not original.query:  # only its id is known
            known = {**answer, "accepted": known["accepted"], "id": known["id"]}
        if known is None or known == answer:
            return original.answer is not None or not request.doubtful
        refused_before = not known["accepted"] and original.answered_at >= request.at  # and forgotten, as its id
        require(
            request.doubtful or refused_before,
            f"{request} repeats {original}, which was answered by {original.answer}: {answer}",
        )
        request.original = None
        return False

    def accepted(self, ran: Ran) -> None:
        """Judges the acceptance of a goal or jog that came by a put, which has no answer."""
        kind = "jog" if ran.jog else "goal"
        mine = [r for r in self._a.requests if r.key == kind and r.answer is None and r.goal == ran.goal]
        mine = [r for r in mine if r.original is None]
        if len(mine) == 1 and not mine[0].query:
            mine[0].answer, mine[0].answered_at = {"accepted": True, "id": ran.goal}, self._a.now
            self._begins_in_order(mine[0], ran, f"the put {mine[0]}")

    def _begins(self, request: Request, answer: Payload, text: str) -> None:
        a, goal = self._a, str(answer.get("id"))
        require(request.goal is None or goal == request.goal, f"{text} has the id {goal}")
        jog = request.key == "jog"
        require(goal.startswith("jog-") or not jog, f"{text}: the id of a jog begins with jog-")
        mine = [ran for ran in a.ran(goal) if self._fits(ran, request, jog)]
        require(mine, f"{text}, but the executor has accepted no such program")
        told_by = (ran for ran in mine if f", {switches_of(ran.program)} switch" in answer["message"])
        ran = next(told_by, mine[0])  # puts of the same id have no answers
        self._begins_in_order(request, ran, text)
        behind = a.had("disk", ran.at - WRITTEN_WITHIN) or a.reconnecting  # the answer waits behind results
        waited = 0.0 if behind else a.awake - ran.awake
        require(waited <= WRITTEN_WITHIN, f"{text} comes {waited:g} s after the executor has accepted it")
        words = (JOG_WORDS if jog else WORDS).fullmatch(answer["message"])
        require(words is not None, f"{text} has other words")
        assert words is not None
        planned = switches_of(ran.program) if ran.program.final else None
        told = ran.planned = int(words[1]) if jog else int(words[2])
        require(planned is None or told == planned, f"{text}; the program has {planned} switches")
        require(jog or int(words[1]) == len(request.body["waypoints"]), f"{text} has another number of waypoints")
        if jog:
            judge_jog(a, request, ran, text)
        else:
            ran.homed = int(words["homed"] or 0)
            require(ran.homed == len(answer["homing"]), f"{text} counts other actuators than it names")
            judge_homing(a, request, words["unchecked"], text)

    def _begins_in_order(self, request: Request, ran: Ran, text: str) -> None:
        """Judges when a goal or jog has begun, and after what."""
        a = self._a
        ran.request = request
        ran.places = ran.places if lined(request) else {}
        for barrier in self._barriers:
            bars = barrier.number > request.number and barrier.answered_at < ran.at and barrier.process == a.process
            mine = barring(barrier) or barrier.goal == ran.goal
            require(not (bars and mine), f"{text}; it begins {a.now - ran.at:g} s ago, after the answer to {barrier}")
        for other in a.programs.values():
            if other.request is not None and other.process == a.process and other is not ran:
                ordered = (other.at < ran.at) == (other.request.number < request.number)
                require(ordered, f"{text} begins out of order with {other.request}")
        if request.body.get("stamp") and not a.had("clock", request.at - 1.0):
            over = a.wall() - (a.now - ran.at) - ends_at(request)
            require(over <= STAMPED_WITHIN, f"{text}; it begins {over:g} s after its end")
        lost = a.lost_between(request.at, ran.at)
        require(not lost, f"{text}; it has begun after the executor was lost")
        late = ran.at - request.sent_at
        require(late <= patience(request) + LATE, f"{text}; it has begun {late:g} s after it was sent")

    def _fits(self, ran: Ran, request: Request, jog: bool) -> bool:
        mine = ran.request is None and ran.jog == jog and ran.instance and ran.process == request.process
        return bool(mine) and ran.at >= request.at and not ran.given_up

    def _bars(self, request: Request, answer: Payload, text: str) -> None:
        a = self._a
        if request.key == "reset":
            return  # in mode ready it changes nothing; otherwise nothing waits
        self._barriers = [*self._barriers[-20:], request]
        self.barred(request)
        if request.goal is not None:
            not_running = "is not running" in answer["message"]
            runs = [ran for ran in a.ran(request.goal) if ran.process == a.process and ran.ended is None]
            runs = [r for r in runs if r.request is not None and r.at < request.at]
            runs = [r for r in runs if r.instance == a.instance and not r.results and self._shown(r)]
            require(not (not_running and runs), f"{text}, but it runs")
            kinds = ENDED_BY_CANCEL.get(answer["message"], ())
            waited = [r for r in a.requests if r.key in kinds and r.goal == request.goal and r.number < request.number]
            waited = [r for r in waited if r.answer is None or r.answered_at >= request.at]
            require(waited or not kinds, f"{text}, but none waited")

        def ended() -> None:
            for ran in a.programs.values():
                earlier = ran.request is not None and ran.request.number < request.number
                named = request.goal in (None, ran.goal)
                runs = earlier and named and ran.ended is None and ran.instance == a.instance and a.instance
                require(not runs or not a.clear(), f"{text}; {ran.goal} still runs {ENDS_WITHIN} s later")

        self._later(ENDS_WITHIN, ended)

    def _shown(self, ran: Ran) -> bool:
        """Returns whether the newest snapshot shows a program: the result of one that has ended may still wait."""
        return self._a.snapshot is not None and self._a.snapshot.program == ran.program.program

    def _take_obstacles(self, request: Request, answer: Payload, text: str) -> None:
        a = self._a
        words = OBSTACLES.fullmatch(answer["message"])
        require(words is not None, f"{text} has other words")
        assert words is not None
        newest = [r for r in a.requests if r.key == "obstacles" and r.number >= request.number]
        counts = {len(r.body.get("regions", ())) for r in newest if well_formed(r, a.modules)}
        require(int(words[2]) in counts and words[1] == words[2], f"{text}; {counts} were sent")
        if request.number > a.cubes_number:
            if set(request.cubes) != set(a.cubes) and len(a.waiting("obstacles")) == 0:
                self._later(SHOWN_WITHIN, lambda: self._judge_number(request))
            a.cubes, a.cubes_number, a.cubes_at = request.cubes, request.number, a.now
            a.note("cubes")

    def _judge_number(self, request: Request) -> None:
        """Judges that the number of obstacles in `state` has grown since other obstacles arrived."""
        shown = self._a.shown_obstacles
        require(shown > request.shown, f"{request} was accepted, and state tells the number {shown} as before")

    def _locks(self, request: Request) -> None:
        a = self._a
        k = a.modules.labels.index(request.body["actuator"])
        state = request.body["state"]
        moments = [h.snapshot for h in a.truths(a.awake - request.awake + DELAY) if h.snapshot is not None]
        fits = state is None or not moments or any(leaves_states(a.modules, s, k, state) for s in moments)
        require(fits, f"{request} is accepted, and leaves a module without state")

        def told() -> None:
            newer = [r for r in a.requests if r.key == "degrade" and r.number > request.number]
            snapshot = a.snapshot
            booted = any(h.snapshot is None or h.snapshot.mode not in RUNS for h in a.truths(2 * LOCKED_WITHIN))
            if snapshot is None or newer or booted or not a.clear():
                return
            locked = unpack(snapshot.locked) >> k & 1
            require(locked == (state is not None), f"{request} was accepted, locked is {unpack(snapshot.locked):b}")
            measured = unpack(snapshot.measured) >> k & 1
            require(state is None or measured == state, f"{request} was accepted, {k} is locked in {measured}")

        self._later(LOCKED_WITHIN, told)

    def _judge_result(self, request: Request, answer: Payload) -> None:
        a, result = self._a, answer.get("result")
        newest = a.ran(request.goal or "")[-1:]  # an older goal of this id no longer counts
        told = [r for ran in newest if ran.recorded_at < request.at for r in ran.results]
        every = [r for ran in a.ran(request.goal or "") for r in ran.results]
        if result is None:
            require(not told or a.disk_failed, f"{request} is answered by {answer}; {told} were told")
            return
        fields = ("id", "status", "code", "message", "switches")
        same = any(all(result[name] == known[name] for name in fields) for known in every)
        require(same or a.had("planner ended", a.now - 10.0), f"{request} is answered by {answer}; told were {every}")

    def _later(self, seconds: float, judge: Callable[[], None]) -> None:
        self._claims.append((self._a.awake + seconds, judge))

    def tick(self) -> None:
        """Finds answers that do not come, and judges claims that are due."""
        a = self._a
        for due, judge in [claim for claim in self._claims if claim[0] <= a.awake]:
            self._claims.remove((due, judge))
            judge()
        for request in a.requests:
            if request.answer is not None or not request.query:
                continue
            waited = a.awake - request.awake
            self._judge_alone(request)
            if a.reconnecting:  # answers wait behind results
                continue
            longest = ANSWERED_WITHIN.get(request.key, patience(request) + LATE + WRITTEN_WITHIN)
            if a.congested or a.lately("congested", longest):
                longest += SLOW_PEER * sum(r.query and r.answered_at >= request.at for r in a.requests)
            if request.key == "obstacles" and (a.scene_building or a.had("cubes", a.now - longest)):
                continue
            require(waited <= longest, f"{request} has no answer after {waited:g} s, awake; {longest:g} s at most")
            if request.key in ("goal", "jog") and self._free(request):
                require(waited <= SOON, f"{request} has no answer after {waited:g} s, and nothing stands in its way")
        if len(a.requests) > 400:
            a.requests = [r for r in a.requests if r.answer is None or r.at > a.now - REMEMBERED]

    def _judge_alone(self, request: Request) -> None:
        """Finds a request that waits for an executor, though none is connected: it is refused at once."""
        a = self._a
        if a.slow or a.congested or a.reconnecting or a.lately("congested", 0.5) or a.lately("still", 0.5):
            return
        waited = a.awake - max(request.awake, a.alone_since + ALONE)
        executors = ANSWERED_WITHIN.get(request.key) == EXECUTOR_ANSWERS
        require(not executors or waited <= ALONE, f"{request} waits for {waited:g} s, and no executor is connected")

    def _free(self, request: Request) -> bool:
        """Returns whether nothing stands in the way of a goal or jog."""
        a = self._a
        alone = len(a.waiting("goal", "jog", "plan", "degrade")) == 1
        slow = a.had("slow search", request.at - 10.0) or a.building or a.scene_building
        return alone and a.clear() and not slow


def switches_of(program: Program) -> int:
    """Returns the number of switches of a program's stages, without those of locked actuators."""
    before, switches = unpack(program.start), 0
    for stage in program.stages:
        switches += (unpack(stage.states) ^ before).bit_count()
        before = unpack(stage.states)
    return switches
