"""Feedback and results: told once, in order, with the numbers of the world, and with a status that has a cause."""

from __future__ import annotations

import math
from typing import Any

from hyperbit.controller.program import Ended, Settled, unpack
from tests.simulation.judge.interface.account import RECONNECTED, InterfaceAccount
from tests.simulation.judge.interface.asked import barring, decodable, lined, wanted
from tests.simulation.judge.interface.facts import Payload, Ran, Request
from tests.simulation.judge.interface.modules import turn
from tests.simulation.judge.interface.progress import Progress
from tests.simulation.judge.interface.refusals import judge_refusal
from tests.simulation.judge.interface.words import Words
from tests.simulation.judge.verdict import Violation, require

TOLD_WITHIN = 1.5  # [s], awake, from the executor's report to the publication: deviations, ledger and outbox
RECONNECTS_WITHIN = 6.0  # [s], awake, added to the results of an earlier process, and after the process stood still
RECORDED_WITHIN = 0.06  # [s], awake, from a publication to its record: it counts as sent after 0.05 s
CODES = {"canceled": -1, "replaced": -1, "aborted": -4, "lost": -4}
EPSILON = 1e-9
PROOFS = ("optimal", "bound", "unknown")


class Results:
    """Judges feedback and results."""

    def __init__(self, account: InterfaceAccount, progress: Progress) -> None:
        self._a, self._words, self._progress = account, Words(account), progress

    def feedback(self, payload: Payload) -> None:
        a, goal = self._a, str(payload["id"])
        text = f"feedback {payload}"
        ran = next((ran for ran in reversed(a.ran(goal)) if not ran.jog and ran.process == a.process), None)
        require(ran is not None and not ran.results, f"{text}, but no such goal runs")
        assert ran is not None
        waypoint = payload["waypoint"]
        mark = ran.mark(waypoint)
        require(mark in ran.settled, f"{text}, but the executor has told no such mark")
        last = ran.mark(ran.feedback[-1]["waypoint"]) if ran.feedback else -1
        require(mark > last, f"{text} comes after that of waypoint {last}")
        ran.feedback.append(payload)
        self._progress.feedback(ran, payload)
        settled, _ = ran.settled[mark]
        require(payload["switches"] == settled.switches, f"{text}; the executor tells {settled.switches} switches")
        stages = sum(s.stages for m, (s, _) in ran.settled.items() if last < m <= mark)
        require(payload["stages"] == stages, f"{text}; the executor tells {stages} stages")
        self._judge_excursion(ran, payload, last, mark, text)
        self._judge_pose(payload, settled, text)
        if ran.request is not None:
            waypoints = ran.request.body["waypoints"]
            require(payload["waypoints"] == len(waypoints), f"{text}; the goal has {len(waypoints)} waypoints")
            self._judge_error(payload, ran.request, waypoint, text)

    def _judge_excursion(self, ran: Ran, payload: Payload, last: int, mark: int, text: str) -> None:
        """Compares the excursion with the greatest deviation of the transitions since the waypoint before."""
        told = payload["excursion"]
        if ran.replaced:
            return
        kinds = ("motion asked", "cubes", "still", "slow search", "disk")
        calm = self._a.clear() and not any(self._a.had(kind, ran.at) for kind in kinds) and not self._a.slow
        require(ran.deviations or not calm, f"{text}; nobody has asked for the deviations of its plan")
        transitions = [(m, settled.planned) for m, (settled, _) in ran.settled.items() if last < m <= mark]
        known = [ran.deviations[m] if planned and m < len(ran.deviations) else None for m, planned in transitions]
        greatest = None if None in known else max((value for value in known if value is not None), default=0.0)
        require(told == greatest, f"{text}; the deviations are {known}")

    def _judge_pose(self, payload: Payload, told: Settled | Ended, text: str) -> None:
        """Compares configuration, position and orientation with measured states."""
        a = self._a
        everything = (1 << len(a.modules.labels)) - 1
        code = unpack(told.measured) if unpack(told.known) == everything else -1
        tip = a.modules.tips.get(code)
        if tip is None:
            require(payload["configuration"] is None and payload["position"] is None, f"{text}; measured is {code:b}")
            return
        notation = a.modules.notations[code]
        require(payload["configuration"] == notation, f"{text}; measured is {notation}")
        apart = math.dist(payload["position"], tip.position)
        require(apart < 1e-6 and abs(payload["orientation"] - tip.angle) < 1e-6, f"{text}; the tip is at {tip}")

    def _judge_error(self, payload: Payload, request: Request, index: int, text: str) -> None:
        """Compares the errors with a waypoint; with a configuration there is a distance, too."""
        a, waypoint = self._a, request.body["waypoints"][index]
        turned, asked = payload["orientation_error"], a.turned(request, waypoint)
        require((turned is None) == (asked is None or payload["position"] is None), f"{text}; it is {waypoint}")
        if turned is not None and asked is not None:
            apart = abs(turn(payload["orientation"], asked))
            require(abs(turned - apart) < 1e-6, f"{text}; it is turned by {apart} from {waypoint}")
        if payload["position"] is None:
            require(payload["error"] is None, f"{text} has an error without a position")
            return
        goal, bias = self._place(waypoint), payload.get("bias") or (0.0, 0.0)
        fixed = "configuration" in waypoint
        at = payload["position"] if fixed else [x + b for x, b in zip(payload["position"], bias, strict=True)]
        error = math.dist(at, goal)
        told = payload["error"]
        require(told is not None and abs(told - error) < 1e-6, f"{text}; the distance is {error} from {waypoint}")
        require((payload.get("bias") is None) == (a.bias is None), f"{text}; a tracker: {a.bias is not None}")

    def _place(self, waypoint: Payload) -> Any:
        if "position" in waypoint:
            return waypoint["position"]
        return self._a.modules.tips[self._a.modules.codes[waypoint["configuration"]]].position

    def result(self, payload: Payload) -> None:
        a = self._a
        if payload["status"] == "refused":
            self._judge_refused(payload)
            return
        text = f"result {payload}"
        fields = {name: value for name, value in payload.items() if name != "repeated"}
        ran = self._of(payload, text)
        if ran.results:
            require(payload.get("repeated") is True, f"{text} is told again")
            first = {name: ran.results[0][name] for name in ("status", "code")}
            require(all(fields[name] == value for name, value in first.items()), f"{text} differs from {first}")
            return
        require(not payload.get("repeated") or a.had("planner ended", ran.at), f"{text}, for the first time")
        early = ran.process != a.process and a.now - a.began_at < RECONNECTED - 0.1 and not a.quits
        require(not early, f"{text} is of an earlier process, and clients have not found this one")
        unreached = a.unreached and not a.quits
        require(not unreached, f"{text} is published before clients have reconnected")
        ran.results.append(payload)
        ran.told_awake = a.awake
        ended = ran.ended if ran.heard_at <= a.now and payload["status"] != "lost" else None
        if payload.get("repeated") and ended is not None and ran.heard_by != a.process:
            self._judge_mark(ended, payload, text)
            return
        if payload["status"] != "lost" and not (payload["status"] == "aborted" and ended is None):
            require(ended is not None, f"{text}, but the executor has told no end")
        self._judge_status(ran, ended, payload, text)
        self._words.judge_message(ran, ended, payload, text)
        if ended is None:
            told = max((settled.switches for settled, _ in ran.settled.values()), default=0)
            least, most = (told, ran.switches) if ran.process == a.process else (0, ran.switches)
            require(least <= payload["switches"] <= most, f"{text}; {least} were told, the bus had {most}")
            return
        require(payload["switches"] == ended.switches, f"{text}; the executor tells {ended.switches}")
        self._judge_pose(payload, ended, text)
        if ran.jog:
            self._judge_travels(payload, ended, text)
        elif ran.process == a.process and payload["status"] != "lost":
            self._judge_feedback_complete(ran, text)
        if payload["status"] == "succeeded":
            self._progress.result(ran)
        if not ran.jog and (payload["status"] != "lost" or ran.process == a.process):
            self._judge_proof(ran, payload, text)

    def _judge_mark(self, ended: Ended, payload: Payload, text: str) -> None:
        """Judges a result of which only the mark of an earlier process tells: where the arm was is not known."""
        unknown = [payload[name] for name in ("configuration", "position", "error")]
        require(unknown == [None] * 3, f"{text} tells where the arm was")
        require(payload["switches"] == ended.switches, f"{text}; the executor told {ended.switches}")
        done = payload["status"] == "succeeded" or payload["code"] == -5
        require(done == (ended.status == "done") or payload["status"] == "aborted", f"{text}; it was {ended.status}")

    def _of(self, payload: Payload, text: str) -> Ran:
        """Returns the program of a result: the newest one that has ended or is lost, and has none."""
        every = self._a.ran(str(payload["id"]))
        require(every, f"{text}, which was not accepted")
        without = [ran for ran in every if not ran.results and not ran.given_up]
        if payload["status"] != "lost":
            without.sort(key=lambda ran: ran.ended is None)
        return (without or every)[0 if without else -1]

    def _judge_refused(self, payload: Payload) -> None:
        a = self._a
        puts = [r for r in a.requests if not r.query and r.answer is None]
        if payload["id"] is None:
            motions = ("goal", "jog")
            puts = [r for r in puts if r.key not in motions or "*" in r.name or not decodable(r, a.modules)]
        else:
            named = [r for r in puts if r.key == "goal" and r.goal == payload["id"]]
            puts = named or [r for r in puts if r.key in ("goal", "jog") and r.goal is None]
        fields = {name: value for name, value in payload.items() if name != "status"}
        require(puts, f"result {payload}, but no put waits")
        failed: BaseException
        for request in puts:
            if request.original is not None and request.original.answer == fields:
                request.answer, request.answered_at = fields, a.now
                return
            try:
                judge_refusal(a, request, fields)
            except (Exception, Violation) as error:
                failed = error
            else:
                request.answer, request.answered_at = fields, a.now
                return
        raise failed

    def records(self, goal: str) -> None:
        """Judges when the planner has a published result recorded: as soon as it has surely left the process."""
        a = self._a
        mine = [ran for ran in a.ran(goal) if ran.results and not ran.recorded and ran.process == a.process]
        held_up = a.slow or a.congested or a.lately("congested", 1.0) or a.lately("still", 0.5) or a.quits
        if len(mine) == 1 and not held_up:
            waited = a.awake - mine[0].told_awake
            require(waited <= RECORDED_WITHIN, f"the result of {goal} is recorded {waited:g} s after it was published")

    def _judge_status(self, ran: Ran, ended: Ended | None, payload: Payload, text: str) -> None:
        a, status = self._a, payload["status"]
        cause = ended.status if ended is not None else "lost"
        if status == "succeeded":
            require(cause == "done", f"{text}; the executor tells {ended}")
            require(payload["code"] == 0, f"{text} has code {payload['code']}")
            self._judge_reached(ran, payload, True, text)
        elif status == "aborted" and cause == "done" and payload["code"] == -5:
            self._judge_reached(ran, payload, False, text)
        else:
            require(status in CODES and payload["code"] == CODES[status], f"{text} has another status or code")
            require(status != "lost" or ran.instance != a.instance, f"{text}, but its executor lives")
            self._judge_cause(ran, status, payload, text)

    def _judge_cause(self, ran: Ran, status: str, payload: Payload, text: str) -> None:
        """Finds what has ended a goal before it was done."""
        a = self._a
        own = ran.request.number if ran.request is not None else 0
        later = [r for r in a.requests if r.number > own and r.at <= a.now]
        if status == "canceled":
            cancels = [r for r in later if r.key == "cancel" and r.goal in (None, ran.goal)]
            require(cancels or ran.process != a.process, f"{text}; no cancel came after it")
        elif status == "replaced":
            others = [o for o in a.programs.values() if o.at >= ran.at and o is not ran and o.instance == ran.instance]
            died = a.had("offered", ran.ended_at) and a.had("executor ended", ran.ended_at)  # before it accepted
            require(others or died or a.had("setpoint", ran.at - 0.5), f"{text}; nothing has replaced it")
        elif status == "aborted":
            stops = [r for r in later if barring(r) or r.key == "obstacles"]
            kinds = ("fault", "epoch", "link", "executor ended", "planner ended", "quit", "halted", "touched", "cubes")
            erred = payload["message"].startswith("after waypoints[") and a.had("search errs", ran.at - 10.0)
            calm = a.clear() and not stops and not erred and not any(a.had(kind, ran.at) for kind in kinds)
            require(not calm, f"{text}; nothing has ended it")

    def _judge_reached(self, ran: Ran, payload: Payload, reached: bool, text: str) -> None:
        """Compares the measured configuration with the last waypoint, or with the states of a jog."""
        a, request = self._a, ran.request
        if request is None:
            return
        if ran.jog:
            assert ran.ended is not None
            measured, known = unpack(ran.ended.measured), unpack(ran.ended.known)
            wrong = [
                label
                for label, state in request.body["actuators"].items()
                if not known >> (k := a.modules.labels.index(label)) & 1 or measured >> k & 1 != (state == "extended")
            ]
            require(bool(wrong) != reached, f"{text}; in other states are {wrong}")
            return
        code = None if payload["configuration"] is None else a.modules.codes[payload["configuration"]]
        bias = payload.get("bias")
        known_bias, a.bias = a.bias, None if bias is None else tuple(bias)
        serving = wanted(a, request)[-1]
        a.bias = known_bias
        require((code in serving) == reached, f"{text}; the last waypoint is {request.body['waypoints'][-1]}")
        if reached:
            self._judge_error(payload, request, -1, text)

    def _judge_feedback_complete(self, ran: Ran, text: str) -> None:
        told = {ran.mark(payload["waypoint"]) for payload in ran.feedback}
        missing = (ran.settled.keys() & set(ran.places.values()) if ran.places else ran.settled.keys()) - told
        require(not missing, f"{text} comes without the feedback of {sorted(missing)}")

    def _judge_travels(self, payload: Payload, ended: Ended, text: str) -> None:
        labels, names = self._a.modules.labels, ("contracted", "extended")
        travels = [(labels[t.actuator], names[t.state], t.seconds) for t in ended.travels]
        told = [(t["actuator"], t["state"], t["seconds"]) for t in payload["travels"]]
        require(told == travels, f"{text}; the executor tells {travels}")

    def _judge_proof(self, ran: Ran, payload: Payload, text: str) -> None:
        """Compares the certificate with the cheapest way from where the arm was."""
        a, request = self._a, ran.request
        kind, bound = payload["certificate"], payload["lower_bound"]
        require(kind in PROOFS, f"{text} has the certificate {kind}")
        proven = kind in ("optimal", "bound")
        if not proven and a.had("search errs", ran.at - 10.0):
            return
        require((bound is not None) == proven and (payload["optimal"] is not None) == proven, f"{text} proves half")
        require(not proven or payload["optimal"] == (kind == "optimal"), f"{text} is {kind}")
        as_planned = payload["status"] == "succeeded" and payload["planned_switches"] == payload["switches"]
        require(proven == as_planned or ran.process != a.process, f"{text} is proven, as planned: {as_planned}")
        if not proven or request is None or not ran.exact or lined(request):
            return
        bias = payload.get("bias")
        known_bias, a.bias = a.bias, None if bias is None else tuple(bias)
        sets = wanted(a, request)
        a.bias = known_bias
        least = a.modules.least(ran.states, ran.locked, ran.cubes, sets)
        require(bound <= least + EPSILON, f"{text}; a way of cost {least} is possible")
        if payload["optimal"] and a.modules.uniform:
            require(payload["switches"] <= least + EPSILON, f"{text}; {least} switches are possible")

    def tick(self) -> None:
        """Finds results and feedback that do not come."""
        a = self._a
        for ran in a.programs.values():
            if ran.results or ran.given_up or ran.request is None or ran.process != a.process:
                continue
            waited = a.awake - ran.heard_awake
            longest = TOLD_WITHIN + RECONNECTS_WITHIN * a.had("still", a.now - 2 * RECONNECTS_WITHIN)
            late = (
                waited > longest
                and not a.reconnecting
                and not a.had("slow search", a.now - 10.0)
                and not a.had("disk", a.now - 5.0)
            )
            require(not late, f"goal {ran.goal} has ended, and has no result after {waited:g} s")


def unanswered(a: InterfaceAccount) -> list[Request]:
    return [request for request in a.requests if request.query and request.answer is None]
