"""`state`: true within a stated delay of the world, and told often enough."""

from __future__ import annotations

import math

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.facts import Heard, Payload, Ran
from tests.simulation.judge.interface.grounds import planned_from
from tests.simulation.judge.interface.modules import Cube, turn
from tests.simulation.judge.interface.progress import Progress
from tests.simulation.judge.interface.words import Words
from tests.simulation.judge.verdict import require

CHANGED_WITHIN = 0.045  # [s], awake, from a snapshot with another mode or other outputs to a state, without trouble
EVERY = 0.1  # [s], awake, longest time between two states: 20 times a second, and the outbox
STAMPED_WITHIN = 0.03  # [s] between a state and its publication
CHECKED_WITHIN = 0.5  # [s], awake, from obstacles or an arm that moved to the warning `in-obstacle`
CHECKED_AGAIN = 1.0  # [s] from a check that fails to the next one
TOLD_WITHIN = 1.5  # [s], awake, from the end of a goal to a state that no longer names it
OWN = {"degraded", "unknown-state", "in-obstacle", "executor-lost", "internal-error"}  # faults of the planner
SHELL = {"clock-set", "certificate-ends", "network-lost", "ledger-unwritten"}


class States:
    """Judges what is published about the arm."""

    def __init__(self, account: InterfaceAccount, progress: Progress) -> None:
        self._a, self._words, self._progress = account, Words(account), progress
        self.begin()

    def begin(self) -> None:
        self.latest: Payload | None = None
        self._told = self._a.awake
        self._obstacles = 0
        self._waypoint: tuple[object, int] = (None, -1)

    def state(self, payload: Payload) -> None:
        """Judges a state: one snapshot of the last moments explains all of its fields."""
        a = self._a
        self.latest, self._told = payload, a.awake
        whys = list[str]()
        for heard in a.truths():
            whys.append(self._differs(payload, heard))
            if not whys[-1]:
                break
        require(not whys[-1], f"state {payload}: {whys}")
        age = a.wall() - payload["stamp"]
        unsure = a.lately("clock", DELAY) or a.lately("still", DELAY)
        ages = [a.now - (heard.at if heard.snapshot is None else heard.snapshot.at) for heard in a.truths()]
        fits = unsure or any(-STAMPED_WITHIN <= age - known <= STAMPED_WITHIN for known in [0.0, *ages])
        require(fits, f"state {payload} is stamped {age:g} s ago, the snapshots are of {ages} s ago")
        silent = a.awake - a.heard[-1].awake
        runs = payload["mode"] in ("ready", "executing")
        require(not runs or silent <= a.silent_after, f"state {payload}, and the executor is silent for {silent:g} s")
        self._judge_goal(payload)
        require(("bias" in payload) == (a.bias is not None), f"state {payload}; a tracker: {a.bias is not None}")
        if a.bias is not None:
            a.bias = tuple(payload["bias"])
            a.judge_bias(a.bias, f"state {payload}")
        number = payload["obstacles"]
        require(number >= self._obstacles, f"the number of obstacles falls from {self._obstacles} to {number}")
        self._obstacles = a.shown_obstacles = number

    def _differs(self, payload: Payload, heard: Heard) -> str:
        """Returns in which field a state differs from a snapshot; "" if in none."""
        a, snapshot = self._a, heard.snapshot
        mode = payload["mode"]
        if snapshot is None:
            silent = payload["measured"] == [None] * len(a.modules.labels) and payload["commanded"] is None
            told = mode in ("fault", "starting") and silent and payload["tip"] is None
            return "" if told else "there is no connection to the executor"
        modes = {snapshot.mode}
        if snapshot.mode == "ready" and (a.building or a.lately("tables", 2 * DELAY)):
            modes |= {"starting"} | ({"fault"} if a.build_failed else set())
            if a.building and not a.lately("locks", 4 * DELAY) and not a.lately("tables", 4 * DELAY):
                modes -= {"ready"}
        if mode not in modes:
            return f"the mode is {snapshot.mode}, {sorted(modes)}"
        if why := self._words.differs(payload, snapshot):
            return why
        return self._differs_in_states(payload, snapshot) or self._differs_in_faults(payload, snapshot)

    def _differs_in_states(self, payload: Payload, snapshot: Snapshot) -> str:
        a, size = self._a, len(self._a.modules.labels)
        measured, known = unpack(snapshot.measured), unpack(snapshot.known)
        states = [measured >> k & 1 if known >> k & 1 else None for k in range(size)]
        if payload["measured"] != states:
            return f"measured is {states}"
        everything = (1 << size) - 1
        code = measured if known == everything else -1
        if payload["configuration"] != a.modules.notations.get(code):
            return f"the configuration is {a.modules.notations.get(code)}"
        tip, told = a.modules.tips.get(code), payload["tip"]
        if (tip is None) != (told is None):
            return f"the tip is {tip}"
        if tip is not None and told is not None:
            apart = math.dist(tip.position, told["position"]) + abs(tip.angle - told["orientation"])
            if apart > 1e-6:
                return f"the tip is {tip}"
        held = unpack(snapshot.locked) & known
        commanded = measured & held | unpack(snapshot.outputs) & ~held
        if not snapshot.moving:
            commanded = measured & known | commanded & ~known
        surely = known | unpack(snapshot.homing) == everything
        expected = [commanded >> k & 1 for k in range(size)] if surely else None
        return "" if payload["commanded"] == expected else f"commanded is {expected}"

    def _differs_in_faults(self, payload: Payload, snapshot: Snapshot) -> str:
        a = self._a
        told = [(f["code"], f["source"], f["message"]) for f in payload["faults"]]
        theirs = [(f.code, f.source, f.message) for f in snapshot.faults if f.code != "degraded"]
        missing = [fault for fault in theirs if fault not in told]
        if missing:
            return f"{missing} are not told"
        extra = [f for f in told if f not in theirs and f[0] not in OWN | SHELL]
        if extra:
            return f"{extra} are no faults"
        unread = [label for k, label in enumerate(a.modules.labels) if unpack(snapshot.unread) >> k & 1]
        if payload["unread"] != unread:
            return f"unread are {unread}"
        codes = {fault[0] for fault in told}
        everything = (1 << len(a.modules.labels)) - 1
        surely = unpack(snapshot.known) | unpack(snapshot.homing) == everything
        odd = planned_from(snapshot) not in a.modules.tips
        if ("unknown-state" in codes) != (surely and odd and not snapshot.moving):
            return f"unknown-state: {unpack(snapshot.measured):b} is {'no' if odd else 'a'} configuration"
        if "executor-lost" in codes:
            return "the executor is connected"
        return self._differs_in_locks(payload, snapshot)

    def _differs_in_locks(self, payload: Payload, snapshot: Snapshot) -> str:
        a = self._a
        surely = unpack(snapshot.known) | unpack(snapshot.homing) == (1 << len(a.modules.labels)) - 1
        if not surely or snapshot.moving:
            return ""
        locked, measured, known = unpack(snapshot.locked), unpack(snapshot.measured), unpack(snapshot.known)
        listed = [
            {"actuator": label, "state": measured >> k & 1}
            for k, label in enumerate(a.modules.labels)
            if locked >> k & 1 and known >> k & 1
        ]
        told = [fault["source"] for fault in payload["faults"] if fault["code"] == "degraded"]
        if payload["degraded"] != listed or told != [entry["actuator"] for entry in listed]:
            return f"locked are {listed}"
        return ""

    def _judge_goal(self, payload: Payload) -> None:
        """Judges goal, waypoint and target."""
        a, goal = self._a, payload["goal"]
        mine = [ran for ran in a.programs.values() if ran.process == a.process]
        running = [ran for ran in mine if ran.instance == a.instance]
        if any(heard.snapshot is not None for heard in a.truths()):
            running = running if goal is None else mine  # the planner has not heard yet that the executor has ended
        if goal is None:
            require(payload["waypoint"] is None and payload["target"] is None, f"state {payload} has no goal")
            for ran in running:
                lately = a.awake - ran.accepted_awake < DELAY or ran.ended is not None or ran.given_up
                require(lately or a.snapshot is None, f"state names no goal, and {ran.goal} runs")
            self._progress.state(None, payload)
            return
        ran = next((r for r in reversed(running) if r.goal == goal), None)
        require(ran is not None, f"state names the goal {goal}, which does not run")
        assert ran is not None
        over = a.awake - ran.heard_awake > TOLD_WITHIN and not a.had("slow search", a.now - 10.0)
        require(not over, f"state names the goal {goal}, which has ended")
        self._progress.state(ran, payload)
        if not ran.jog:
            self._judge_target(ran, payload)

    def _judge_target(self, ran: Ran, payload: Payload) -> None:
        a, waypoint, target = self._a, payload["waypoint"], payload["target"]
        same, last = self._waypoint
        require(same is not ran or (waypoint is None and last < 0) or waypoint >= last, f"state {payload} goes back")
        self._waypoint = ran, -1 if waypoint is None else waypoint
        marks = [mark for mark, awake in ran.begun_marks if awake < a.awake - DELAY]
        least = max(marks, default=-1)
        most = max((mark for mark, _ in ran.begun_marks), default=-1)
        least, most = ran.waypoint(least), ran.waypoint(most)
        told = -1 if waypoint is None else waypoint
        require(least <= told <= most, f"state of {ran.goal} tells waypoint {waypoint}; {least} to {most} has begun")
        if ran.request is None:
            return
        asked = ran.request.body["waypoints"][max(told, 0)]
        place = asked.get("position") or a.modules.tips[a.modules.codes[asked["configuration"]]].position
        if ran.places:
            waypoints = ran.request.body["waypoints"]
            after = waypoints[min(max(told, 0) + 1, len(waypoints) - 1)]["position"]
            detour = math.dist(target["position"], place) + math.dist(target["position"], after)
            require(detour - math.dist(place, after) < 1e-6, f"state tells the target {target}, not from {asked}")
            return
        apart = math.dist(target["position"], place)
        require(apart < 1e-6, f"state tells the target {target} of waypoint {waypoint}; it is {asked}")
        wanted, turned = a.turned(ran.request, asked), target["orientation"]
        require((turned is None) == (wanted is None), f"state tells the target {target}; it is {asked}")
        fits = turned is None or wanted is None or abs(turn(turned, wanted)) < 1e-6
        require(fits, f"state tells the target {target}; it is {asked}")

    def tick(self) -> None:
        """Finds states that do not come."""
        a = self._a
        if a.process and a.now - a.began_at > 0.5 and not a.quits:
            late = a.awake - self._told
            require(late <= EVERY, f"no state for {late:g} s")
            self._judge_change()
        self._find_standing()

    def _judge_change(self) -> None:
        """Finds a change that no state tells."""
        a = self._a
        if len(a.heard) < 2 or not a.clear() or a.slow or a.congested or a.lately("still", 1.0):
            return
        (_, _, before), (_, awake, newest) = a.heard[-2], a.heard[-1]
        if before is None or newest is None or (before.mode, before.outputs) == (newest.mode, newest.outputs):
            return
        waited = a.awake - awake
        told = self._told >= awake or waited <= CHANGED_WITHIN or a.lately("congested", 1.0)
        require(told, f"{newest} came {waited:g} s ago, and no state since")

    def _find_standing(self) -> None:
        """Compares the warning `in-obstacle` with obstacles and measured states that have not changed for a while."""
        a, snapshot, latest = self._a, self._a.snapshot, self.latest
        kinds = ("cubes", "measured", "still", "slow search")
        changed = any(a.lately(kind, CHECKED_WITHIN) for kind in kinds)
        changed = changed or a.lately("task failed", CHECKED_WITHIN + CHECKED_AGAIN)
        if snapshot is None or latest is None or changed or a.scene_building or a.waiting("obstacles"):
            return
        everything = (1 << len(a.modules.labels)) - 1
        if unpack(snapshot.known) != everything or latest["mode"] == "fault":
            return
        touched = any(Cube.touched(cube, c := unpack(snapshot.measured), c) for cube in a.cubes)
        told = any(fault["code"] == "in-obstacle" for fault in latest["faults"])
        require(told == touched, f"in-obstacle is told: {told}; {unpack(snapshot.measured):b} among {a.cubes}")
