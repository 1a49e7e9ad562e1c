"""What the workers are asked for: from where the arm is, at once, for one goal at a time, and no longer than needed."""

from __future__ import annotations

import math

from hyperbit.controller.program import Snapshot, pack, unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.asked import patience
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.interface.tasks import Search, asks, basis, start_of, tables_of
from tests.simulation.judge.verdict import require

AT_ONCE = 0.005  # [s], awake, from what makes a search possible to its begin, if nothing stands in its way
READ_WITHIN, HELD_UP = 0.003, 0.5  # [s], awake, from the arrival of a snapshot to the core, also if rounds are slow
ANSWERED = 0.03  # [s] from a decision to the answer that leaves
BARS, BARS_FOR = (
    ("stop", "cancel", "reset", "degrade"),
    0.1,
)  # a goal waits for their answers and a snapshot after them [s]
STALE = 0.03  # [s], awake, for which a search from elsewhere, or of a goal that is answered, may go on
HURRIED = 0.03  # [s], awake, from a second goal to the word that the search of the first one must end
LONGEST_PLAN = 10.0  # [s]
PREPARED = 0.15  # [s] without requests until the next search is surely prepared
WAITED = 0.2  # [s], awake, after which a goal without an answer surely waits
REHEARSED = 2.0  # [s] after a goal, in which it is planned again without effect
REHEARSED_EVERY = 0.03  # [s], awake, longest time from a rehearsal to the next one
MOST_PREPARED = 60  # in a second


class Searches:
    """Judges the tasks of the workers.

    Attributes:
        prepares: whether the next search is prepared while no request waits.
        least, most: number of tasks since `count`.
    """

    def __init__(self, account: InterfaceAccount) -> None:
        self._a, self.prepares, self.steps = account, False, 0
        self.begin()

    def begin(self) -> None:
        self._running: dict[int, Search] = {}
        self._prepared: Search | None = None  # the last one
        self._prepared_awake = -math.inf  # end of the last one
        self._improving: Search | None = None  # the last task that improves
        self._searched: tuple[Payload, float] | None = None  # the last goal whose search has ended, and when
        self._planned: tuple[Search, float] | None = None  # the last plan, until something is done with it
        self._second, self._in_second = 0, 0
        self._last = self.least = self.most = 0

    def count(self) -> tuple[int, int]:
        """Returns the least and the greatest number of tasks since the last call."""
        found = self.least, self.most
        self.least = self.most = len(self._running)
        return found

    def begins(self, search: Search) -> None:
        a = self._a
        search.at, search.awake = a.now, a.awake
        text = f"the task {search.number} ({search.kind})"
        require(search.number == self._last + 1, f"{text} comes after task {self._last}")
        self._last = search.number
        self._running[search.number] = search
        self.most = max(self.most, len(self._running))
        if search.start:
            self._judge_start(search, text)
        if search.cubes is not None:
            sets = a.in_force()
            require(set(search.cubes) in sets, f"{text} is among {search.cubes}, in force are {sets}")
        match search.kind:
            case "goal":
                self._planned = None
                self._judge_goal(search, text)
            case "improve":
                search.ran = next(reversed(a.programs.values()), None)
                self._improving = search
            case "prepare":
                self._judge_prepared(search, text)
            case "stages":
                require(search.cubes, f"{text} looks for collisions, and there is no obstacle")
            case "standing":
                require(self._heard(search.states[0]), f"{text} is for {search.states[0].hex()}")
        if search.kind == "plan" and search.goal is not None:
            longest = LONGEST_PLAN + (search.goal["deadline"] or 0.0)
            require(search.goal["seconds"] == longest, f"{text} has {search.goal['seconds']} s, not {longest}")
        require(search.improves in (None, self.prepares), f"{text} improves a plan: {search.improves}")
        if search.kind in ("goal", "plan", "follow"):
            self._judge_bias(search, text)

    def hurries(self, number: int) -> None:
        """A worker shall end the search of a task soon."""
        search = self._running.get(number)
        if search is not None:
            require(search.kind in ("goal", "stages"), f"the task {number} ({search.kind}) is hurried")
            search.hurried = True

    def abandons(self, number: int) -> None:
        search = self._running.get(number)
        require(search is None or not search.abandoned, f"the task {number} is abandoned again")
        if search is not None:
            search.abandoned, search.abandoned_in = True, self.steps

    def improves(self, number: int, deviations: tuple[float | None, ...] | None) -> None:
        """A worker tells the deviations of a running plan, or a better plan: None."""
        search = self._improving
        if search is None or search.number != number or search.ran is None or search.abandoned_in < self.steps:
            return  # the answer that lets a goal end abandons its task
        if deviations is None:
            search.ran.replaced = True
        else:
            search.ran.deviations = deviations

    def offered(self, goal: str) -> None:
        """The executor gets the program of a goal; it may decline it."""
        if self._planned is not None and self._planned[0].goal is not None and self._planned[0].goal["id"] == goal:
            self._planned = None

    def ends(self, number: int, planned: bool = False) -> None:
        """A worker gives its last answer; `planned`: a plan."""
        search = self._running.pop(number, None)
        self.least = min(self.least, len(self._running))
        if search is not None and search.kind == "goal" and search.goal is not None:
            self._searched = search.goal, self._a.now
        if search is not None and search.kind == "prepare":
            self._prepared_awake = self._a.awake
        if search is not None and search.kind == "goal" and planned and not search.abandoned:
            self._planned = search, self._a.awake

    def _judge_start(self, search: Search, text: str) -> None:
        """Compares the start with the newest snapshot, and the tables with its locks."""
        starts = [start_of(s, len(self._a.modules.labels)) for s in self._newest()]
        require(search.start in starts, f"{text} starts at {search.start}, the arm is at {starts}")
        have = self._a.tables
        require(search.tables == have, f"{text} is for the locks {search.tables.hex()}, tables are {have.hex()}")
        needed = [tables_of(s, len(self._a.modules.labels)) for s in self._newest()]
        moves = any(snapshot.moving for snapshot in self._newest())
        require(moves or search.tables in needed, f"{text} is for the locks {search.tables.hex()}, not {needed}")

    def _newest(self) -> list[Snapshot]:
        """Returns the newest snapshot, and those that the process may still have before it."""
        a = self._a
        held_up = a.slow or a.lately("slow", 0.5) or a.lately("still", 0.1)
        return [h.snapshot for h in a.truths(HELD_UP if held_up else READ_WITHIN) if h.snapshot is not None]

    def _heard(self, measured: bytes) -> bool:
        return any(snapshot.measured == measured for snapshot in self._newest())

    def _judge_goal(self, search: Search, text: str) -> None:
        a, goal = self._a, search.goal
        assert goal is not None
        others = [o for o in self._running.values() if o.kind == "goal" and not o.abandoned and o is not search]
        require(not others, f"{text} begins while {others} go on")
        mine = [r for r in a.requests if r.key == "goal" and asks(r, goal)]
        require(mine, f"{text} is for {goal}, for which nobody asked")
        received = [a.wall() - (a.now - r.at) for r in mine]
        known = a.had("clock", a.now - 20.0) or any(abs(goal["received"] - at) < 0.02 for at in received)
        require(known or a.had("still", a.now - 20.0), f"{text} came at {goal['received']}, not at {received}")
        least = min(a.now - r.at for r in mine)
        if (given := mine[-1].body.get("deadline")) is not None:
            fits = given - least - 70.0 < goal["deadline"] <= given + 1e-9
            require(fits, f"{text} has {goal['deadline']} s, its client gives {given} s")
        else:
            require(goal["deadline"] is None, f"{text} has {goal['deadline']} s, its client gives none")

    def _judge_bias(self, search: Search, text: str) -> None:
        a = self._a
        require((search.bias is None) == (a.bias is None), f"{text} is corrected by {search.bias}")
        if search.bias is not None:
            a.judge_bias(search.bias, text)

    def _judge_prepared(self, search: Search, text: str) -> None:
        """The next search is prepared only while no request waits; a goal is rehearsed only soon after it."""
        a, goal = self._a, search.goal
        require(self.prepares, f"{text} is of no use for this method")
        searched = [o for o in self._running.values() if o.kind == "goal" and not o.abandoned]
        require(not searched, f"{text} is prepared during {searched}")
        late = [r for r in a.requests if self._waits(r) and a.awake - r.awake > WAITED]
        free = not a.had("still", a.now - 1.0) and not a.congested and not a.lately("congested", 0.5)
        require(not late or not free, f"{text} is prepared while {late[:1]} waits")
        second = int(a.now)
        self._in_second = self._in_second + 1 if second == self._second else 1
        self._second = second
        require(self._in_second <= MOST_PREPARED, f"{text} is the {self._in_second}th prepared one in this second")
        before, self._prepared = self._prepared, search
        if goal is None:
            same = before is not None and before.goal is None and basis(before) == basis(search)
            kinds = ("motion asked", "scene", "tables")  # what is built anew may be as before, with another number
            interrupted = before is not None and any(a.had(kind, before.at - 0.1) for kind in kinds)
            require(not same or interrupted, f"{text} was prepared before, and nothing has changed")
            return
        require(len(goal["waypoints"]) == 1 and not search.cubes, f"{text} rehearses {goal} among {search.cubes}")
        mine = [r for r in a.requests if r.key == "goal" and asks(r, goal)]
        require(mine, f"{text} rehearses {goal}, for which nobody asked")
        ends = [min(r.answered_at, a.now) for r in mine]
        lately = a.now - max(ends) <= REHEARSED + 0.5 or a.had("still", a.now - 3.0) or a.had("disk", a.now - 3.0)
        require(lately or a.congested, f"{text} rehearses {goal}, which is over")

    def tick(self) -> None:
        """Finds searches that nobody needs, and those that do not begin."""
        a = self._a
        if a.slow or a.lately("still", 0.1) or not a.process or a.quits:
            return
        waiting = [r for r in a.requests if self._waits(r)]
        self._find_late(waiting)
        self._find_unprepared()
        ended = [r.at for r in a.requests if r.accepted and ends_motion(r) and r.answered_at < a.now - STALE - 0.02]
        for search in self._running.values():
            if search.kind == "goal" and not search.abandoned:
                self._judge_needed(search, waiting)
            if search.kind == "follow" and not search.abandoned and ended:
                require(search.at > ended[-1], f"the task {search.number} goes on, and its stream has ended")

    def _find_unprepared(self) -> None:
        """Finds a next search that is not prepared, though nothing has happened for a while."""
        a, snapshot = self._a, self._a.snapshot
        happened = ("motion asked", "answered", "moved", "measured", "locks", "cubes", "tables", "link", "task failed")
        if not self.prepares or snapshot is None or any(a.had(kind, a.now - PREPARED) for kind in happened):
            return
        size = len(a.modules.labels)
        sure = snapshot.known == pack((1 << size) - 1, size) and unpack(snapshot.measured) in a.modules.tips
        busy = a.building or a.scene_building or a.waiting("goal", "jog", "obstacles", "degrade") or snapshot.moving
        busy = bool(busy) or any(s.kind in ("goal", "improve", "plan") for s in self._running.values())
        if not sure or busy or a.had("slow search", a.now - 5.0) or a.congested or self._planned is not None:
            return
        text = "nothing is asked for, and the next search is not prepared"
        require(self._prepared is not None, text)
        assert self._prepared is not None
        require(self._prepared.start == start_of(snapshot, size), f"{text}, but for {self._prepared.start}")
        last = next((r for r in reversed(a.requests) if r.key in ("goal", "jog")), None)
        if last is None or last.key != "goal" or not last.query or last.original is not None or any(a.in_force()):
            return
        soon = a.now - last.at < REHEARSED - 0.5 and last.accepted
        if soon and len(last.body["waypoints"]) == 1:
            rehearsed = self._prepared.goal is not None and asks(last, self._prepared.goal)
            require(rehearsed, f"nothing is asked for, and {last} is not rehearsed")
            goes_on = any(search.kind == "prepare" for search in self._running.values())
            idle = 0.0 if goes_on else a.awake - self._prepared_awake
            require(idle <= REHEARSED_EVERY, f"nothing is asked for, and {last} was rehearsed {idle:g} s ago")

    def _find_late(self, waiting: list[Request]) -> None:
        """Finds a goal that is neither searched nor refused, a plan that is not offered, and a goal without time."""
        a = self._a
        calm = a.clear() and not a.congested and not a.lately("congested", 1.0) and not a.building
        if not calm or a.scene_building or a.had("disk", a.now - 5.0):
            return
        for request in waiting:
            late = a.now - request.at - patience(request)
            require(late < ANSWERED, f"{request} waits {late:g} s after its time")
        if self._planned is not None:
            search, awake = self._planned
            goal = search.goal
            assert goal is not None
            mine = [r for r in a.requests if r.key == "goal" and asks(r, goal)]
            over = (
                not mine
                or any(r.answer is not None for r in mine)
                or any(r.at >= search.at - 20.0 for r in a.ran(goal["id"] or "?"))
            )
            require(over or goal["id"] is None or a.awake - awake < ANSWERED, f"the plan of {goal} is not offered")
        first = min(
            (r for r in a.requests if r.key in ("goal", "jog", "degrade") and r.answer is None),
            default=None,
            key=lambda r: r.number,
        )
        if first is None or first not in waiting or first.key != "goal" or a.now - first.at < ANSWERED:
            return
        snapshot = a.snapshot
        ready = snapshot is not None and snapshot.mode in ("ready", "executing") and self._planned is None
        lately = self._searched is not None and a.now - self._searched[1] < 2 * ANSWERED
        searched = lately or any(
            s.kind == "goal" and s.goal is not None and asks(first, s.goal) for s in self._running.values()
        )
        bars = [r for r in a.requests if r.key in BARS and r.number < first.number]
        epoch = a.had("epoch", a.now - 0.3) or any(r.answered_at > max(first.at - BARS_FOR, a.now - 0.3) for r in bars)
        offered = any(r.goal == first.goal and r.at >= first.at for r in a.programs.values())
        declined = any(a.had(f"declined {why}", a.now - 0.3) for why in ("moved-since-planned", "switch-not-confirmed"))
        require(not ready or searched or epoch or offered or declined, f"{first} is not searched")

    def _judge_needed(self, search: Search, waiting: list[Request]) -> None:
        a, text = self._a, f"the task {search.number} of the goal {search.goal}"
        snapshot = a.snapshot
        if snapshot is not None and search.start != start_of(snapshot, len(a.modules.labels)):
            search.stale_from = min(search.stale_from, a.awake)
        else:
            search.stale_from = math.inf
        late = a.awake - search.stale_from
        require(late <= STALE + 0.02, f"{text} goes on from elsewhere for {late:g} s")
        goal = search.goal
        assert goal is not None
        mine = [r for r in a.requests if r.key == "goal" and asks(r, goal)]
        over = bool(mine) and all(r.answered_at < a.now - STALE - 0.02 for r in mine)
        require(not over or a.congested, f"{text} goes on, and its goal is answered")
        others = [r for r in waiting if not asks(r, goal) and r.at < a.now - HURRIED - 0.05]
        if others and a.awake - search.awake > HURRIED and not a.congested:
            require(search.hurried, f"{text} is not hurried, and {others[0]} waits")

    def _waits(self, request: Request) -> bool:
        """Returns whether a goal or jog surely waits in the planner."""
        mine = request.key in ("goal", "jog") and request.query and request.answer is None and request.original is None
        if not mine or request.doubtful or (request.key == "goal" and request.goal is None):
            return False
        runs = [ran for ran in self._a.programs.values() if ran.at >= request.at]
        return not any(ran.goal == request.goal or (ran.jog and request.key == "jog") for ran in runs)


def ends_motion(request: Request) -> bool:
    """Returns whether a request ends whatever runs."""
    return request.key == "stop" or (request.key == "cancel" and request.goal is None)
