"""The gateway: notes for recorders, floods, saved poses, the description of the arm, and who may use a wildcard."""

from __future__ import annotations

import json
from collections import Counter, deque
from typing import Any

from hyperbit.controller.program import PlayableFaults
from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.interface.messages import well_formed
from tests.simulation.judge.verdict import require

ANY_NAME = ("stop", "cancel", "plan", "arm", "result")  # keys of requests that a wildcard may reach
SERVED = {"goal", "jog", "plan", "stop", "cancel", "reset", "degrade", "obstacles", "fault", "poses", "arm", "result"}
SERVED |= {"setpoint"}
NOTED_WITHIN = 1.5  # [s], awake, from an answer to its note
MOST_NOTES = 45  # refusals in one second; of more, some have no note
FLOOD, PAUSE, EVERY = 20, 0.002, 10  # refusals in a second without a pause, its length [s], requests for each further
MOST_EXPLAINED = 20  # malformed requests in a second whose answers tell the fault
DESCRIBED = {"name", "version", "dimension", "length", "states", "frames", "base", "actuators", "contracted"}
DESCRIBED |= {"tolerance", "travel_time", "on_stop", "on_loss", "inrush", "rest_time", "method", "obstacles", "boards"}
DESCRIBED |= {"body_radius", "self_collision", "limits", "sent_obstacles", "simulated", "simulation", "poses", "daemon"}


class Gateway:
    """Judges what the planner's core does not know.

    Attributes:
        playable: faults that can be played in the boards; None: the boards count as real.
    """

    def __init__(self, account: InterfaceAccount) -> None:
        self._a, self.recorded = account, False
        self.playable: PlayableFaults | None = None
        self.poses: dict[str, Any] = {}  # saved, by name
        self.unwritable = False
        self._homes = ""
        self.begin()

    def begin(self) -> None:
        self._unnoted: dict[int, tuple[Request, float]] = {}
        self._instant, self._arrived, self._pauses = -1.0, Counter[str](), 0
        self._malformed: dict[str, deque[float]] = {}
        self._explained: dict[str, deque[float]] = {}
        self._changes: deque[tuple[float, int]] = deque([(self._a.awake, 0)], maxlen=400)
        self._lists: deque[tuple[float, dict[str, Any]]] = deque([(self._a.now, dict(self.poses))], maxlen=400)

    def arrives(self, request: Request) -> None:
        """Takes a request before the gateway does."""
        a, key = self._a, request.key
        if a.now != self._instant:
            self._instant, self._pauses = a.now, 0
            self._arrived.clear()
        if not well_formed(request, a.modules) and key in ("goal", "plan", "jog", "obstacles", "degrade"):
            handled, paused = self._arrived[key], self._pauses >= 2 or key == "plan"
            require(handled < 45 or paused, f"{handled} malformed requests on {key} came without a pause")
            self._arrived[key] += 1
            self._malformed.setdefault(key, deque(maxlen=400)).append(a.now)
        if key == "poses":
            self._expect(request)
        if key == "arm":
            request.regions = self._sent_regions()

    def unserved(self, name: str) -> None:
        """A message comes to a process that has declared no such key."""
        served = SERVED | ({"measured_tip"} if self._a.bias is not None else set())
        require(self._a.quits or name.rpartition("/")[2] not in served, f"the process does not serve {name}")

    def paused(self, seconds: float) -> None:
        """A thread of the gateway pauses because of a flood."""
        a = self._a
        self._pauses += 1
        lately = [r for r in a.requests if r.at > a.now - 1.5]
        keys = Counter(r.key for r in lately)
        most = max(keys.values(), default=0)
        require(
            seconds == PAUSE and most >= FLOOD, f"the gateway pauses for {seconds} s after {most} requests on a key"
        )

    def answers(self, request: Request, answer: Payload) -> None:
        a = self._a
        accepted = answer.get("accepted") is not False
        if accepted and "*" in request.name:
            named = request.key in ANY_NAME and not (request.key == "cancel" and request.goal is not None)
            require(named, f"{request} was sent to {request.name}, and is carried out")
        if answer.get("reason") == "not-explained":
            lately = [at for at in self._malformed.get(request.key, ()) if request.at - 1.01 < at <= request.at]
            require(len(lately) > MOST_EXPLAINED, f"{request} is not explained, after {len(lately)} malformed ones")
        elif answer.get("reason") in ("not-json", "not-utf8", "no-object") and request.key == "goal":
            times = self._explained.setdefault("goal", deque(maxlen=MOST_EXPLAINED + 1))
            times.append(request.at)
            full = len(times) == times.maxlen and times[-1] - times[0] < 0.99
            require(not full, f"{request} is explained, as {MOST_EXPLAINED} others in the same second")
        if request.key == "poses":
            self._judge_poses(request, answer)
        if self.recorded and request.key != "arm":
            self._unnoted[request.number] = request, a.awake

    def note(self, payload: Payload) -> None:
        a = self._a
        require(self.recorded, f"the note {payload} is for nobody")
        mine = [r for r in a.requests if r.key == payload["key"] and noted(r, payload)]
        text = f"the note {payload}"
        require(mine, f"{text} is on no request")
        fits = [r for r in mine if not r.query or r.answer in (None, payload["answer"])]
        require(fits, f"{text}; the answer was {mine[-1].answer}")
        times = [a.wall() - (a.now - r.at) for r in fits]
        near = any(abs(at - payload["stamp"]) < 0.001 for at in times) or a.had("clock", a.now - 30.0)
        require(near or a.had("still", a.now - 30.0), f"{text} is stamped {payload['stamp']}, not {times}")
        for request in fits:
            if request.number in self._unnoted and request.answer == payload["answer"]:
                del self._unnoted[request.number]
                return

    def tick(self) -> None:
        """Finds requests without a note."""
        a = self._a
        for number, (request, awake) in list(self._unnoted.items()):
            if a.awake - awake <= NOTED_WITHIN:
                break
            del self._unnoted[number]
            second = [r for r in a.requests if abs(r.at - request.at) < 1.5 and r.key == request.key]
            known = request.accepted or len(second) < MOST_NOTES
            held_up = a.congested or a.lately("congested", 3.0) or a.quits
            require(not known or held_up, f"{request} was answered by {request.answer}, without a note")

    def _expect(self, request: Request) -> None:
        """Decides what becomes of a request on poses, which takes effect at its arrival."""
        body, saved = request.body, dict(self.poses)
        request.expected = ""
        if "*" in request.name:
            request.expected = "not-named"
        elif not well_formed(request, self._a.modules):
            request.expected = "malformed"
        elif "save" in body:
            saved[body["save"]] = body["goal"]
        elif saved.pop(body["remove"], None) is None:
            request.expected = "unknown-pose"
        if not request.expected and self.unwritable:
            request.expected = "poses-unwritten"
        if not request.expected:
            self.poses = saved
            self._changes.append((self._a.awake, self._changes[-1][1] + 1))
        self._lists.append((self._a.now, dict(self.poses)))

    def _judge_poses(self, request: Request, answer: Payload) -> None:
        body, text = request.body, f"{request} is answered by {answer}"
        if request.expected == "malformed":
            require(not answer["accepted"], text)
        elif request.expected:
            require(answer.get("reason") == request.expected, f"{text}; it is {request.expected}")
        else:
            done = f"saved pose {body['save']!r}" if "save" in body else f"removed pose {body['remove']!r}"
            require(answer["accepted"] and answer["message"] == done, f"{text}; it is {done}")

    def state(self, payload: Payload) -> None:
        """Judges the number of the poses in a state."""
        a = self._a
        old = [number for awake, number in self._changes if awake <= a.awake - DELAY]
        least, most = old[-1] if old else self._changes[0][1], self._changes[-1][1]
        held_up = a.congested or a.lately("congested", 1.0)
        require(least <= payload["poses"] <= most or held_up, f"state tells the poses {payload['poses']}, not {most}")

    def _judge_simulation(self, answer: Payload, text: str) -> None:
        """Judges whether the boards are simulated, and which faults can be played while an executor is there."""
        require(answer["simulated"] is (self.playable is not None), f"{text} says simulated: {answer['simulated']}")
        told = answer["simulation"]
        a = self._a
        away = a.had("link", a.now - 1.0) or any(heard.snapshot is None for heard in a.truths(DELAY + 0.5 * a.slow))
        require(told is not None or self.playable is None or away, f"{text} tells no faults to play")
        if told is not None:
            require(self.playable is not None, f"{text} tells faults of real boards: {told}")
            assert self.playable is not None
            wanted = {kind: list(getattr(self.playable, kind)) for kind in ("boards", "buses", "interlocks")}
            fields = ("verb", "target", "argument", "text")
            faults = [{name: getattr(verb, name) for name in fields} for verb in self.playable.faults]
            require(told == {**wanted, "faults": faults}, f"{text} tells the faults {told}")

    def description(self, request: Request, answer: Payload) -> None:
        a, text = self._a, f"the answer to {request}"
        missing, wanted = DESCRIBED - answer.keys(), asked_for(request)
        require(not missing, f"{text} has no {missing}")
        for part in ("running", "drawing", "file"):
            require((part in answer) == (part in wanted), f"{text}; {part} is asked for: {part in wanted}")
        require(answer["actuators"] == list(a.modules.labels), f"{text} has the actuators {answer['actuators']}")
        self._judge_simulation(answer, text)
        require(set(answer["daemon"]) == {"host", "pid"}, f"{text} has the daemon {answer['daemon']}")
        self._judge_list(request, answer["poses"], text)
        regions = answer["sent_obstacles"]
        sent = [*request.regions, *self._sent_regions()]
        later = [
            r.body.get("regions") for r in a.requests if r.key == "obstacles" and r.answered_at >= request.at - 0.05
        ]
        require(regions in sent or regions in later, f"arm tells the obstacles {regions}, sent were {sent}")
        limits = [
            [fault.message for fault in h.snapshot.faults if fault.code == "board-limits"] if h.snapshot else []
            for h in a.truths(DELAY + 0.5 * a.slow)
        ]
        held_up = a.congested or a.lately("congested", 1.0) or a.lately("still", 1.0)
        require(answer["limits"] in limits or held_up, f"{text} has the limits {answer['limits']}, not {limits}")
        if "running" in wanted:
            self._judge_running(answer["running"], text, held_up)

    def _sent_regions(self) -> list[Any]:
        """Returns the obstacles that may be in force now, as their clients have sent them."""
        a = self._a
        sent = [[] if r is None else r.body["regions"] for r in a.obstacles_in_force()]
        if not a.cubes:
            return [*sent, []]
        return [*sent, *(r.body["regions"] for r in a.requests if r.cubes and set(r.cubes) == set(a.cubes))]

    def _judge_list(self, request: Request, told: list[Payload], text: str) -> None:
        lists = [saved for at, saved in self._lists if at >= request.at - 0.1] or [self._lists[-1][1]]
        before = [saved for at, saved in self._lists if at < request.at - 0.1]
        lists += before[-1:]
        names = [pose["name"] for pose in told]
        require(names[:1] == ["home"] and names[1:] == sorted(names[1:]), f"{text} has the poses {names}")
        goals = {pose["name"]: pose["goal"] for pose in told}
        home = [saved.get("home") for saved in lists]
        require(goals["home"] in home or len(goals["home"]["waypoints"]) == 1, f"{text} has the home {goals['home']}")
        rest = {name: goal for name, goal in goals.items() if name != "home"}
        known = [{name: goal for name, goal in saved.items() if name != "home"} for saved in lists]
        require(rest in known, f"{text} has the poses {rest}, saved are {known[-1:]}")

    def _judge_running(self, running: Payload | None, text: str, held_up: bool) -> None:
        a = self._a
        mine = [ran for ran in a.programs.values() if ran.process == a.process]
        if running is None:
            long = [
                r for r in mine if r.ended is None and r.instance == a.instance and a.awake - r.accepted_awake > 0.3
            ]
            require(not long or a.snapshot is None or held_up or a.slow, f"{text} tells no goal; {long[-1:]} runs")
            return
        ran = next((r for r in reversed(mine) if r.goal == running["goal"]), None)
        require(ran is not None, f"{text} tells {running} as running")
        assert ran is not None
        if ran.jog:
            require(running["waypoints"] == [], f"{text}; a jog has no waypoints")
        elif ran.request is not None:
            asked = ran.request.body["waypoints"]
            times = [float(w.get("t", 0.0)) for w in asked]
            require([w["t"] for w in running["waypoints"]] == times, f"{text} tells the waypoints {running}")
            for told, waypoint in zip(running["waypoints"], asked, strict=True):
                place = waypoint.get("position") or told["position"]
                apart = max(abs(x - y) for x, y in zip(told["position"], place, strict=True))
                require(apart < 1e-6, f"{text} tells the waypoint {told}; it is {waypoint}")
        over = a.awake - ran.heard_awake > 2.0
        require(not over or held_up or a.had("slow search", a.now - 10.0), f"{text} tells {running}, which has ended")


def asked_for(request: Request) -> set[str]:
    """Returns the parts that a query of `arm` asks for."""
    wanted = request.body.get("with")
    fits = isinstance(wanted, list) and all(isinstance(part, str) for part in wanted) and len(request.body) == 1
    return set(wanted) if fits and isinstance(wanted, list) else set()


def noted(request: Request, note: Payload) -> bool:
    """Returns whether a note has the payload of a request: as JSON, or as text if it is none."""
    data = request.payload
    if not data:
        return note["payload"] is None and "text" not in note
    try:
        return bool(note["payload"] == json.loads(data)) and "text" not in note
    except ValueError:
        return note["payload"] is None and note.get("text") == data[:500].decode(errors="replace")
