"""The account of the planner's side: requests and answers, programs, snapshots that came, and what disturbed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.interface.facts import Heard, Made, Payload, Ran, Request
from tests.simulation.judge.interface.modules import Cube, JudgedModules
from tests.simulation.judge.verdict import require

DELAY = 0.1  # [s], awake, from an event of the world to a `state` that tells it: 20 states a second, and the outbox
TAKEN_WITHIN = 0.01  # [s], awake, from the arrival of a request to the core
LEASE, RECONNECTED = 4.0, 5.0  # [s] of the simulated session; after a standstill, for clients to reconnect
STOOD_STILL, SETTLES = 0.9, 1.2  # [s] of a standstill, and after it, in which what was sent before may arrive
BIAS_WITHIN = 2e-4  # from the tracker's offset
TIP_TAKEN = 0.15  # [s] from the arrival of a measured tip to a state with its bias


class InterfaceAccount:
    """What the judge knows of the planner's side.

    Attributes:
        now: time [s].
        process: number of the present process of the planner; 0 between two.
        requests: all of the present process that may still matter.
        programs: accepted by executors, by identity.
        heard: snapshots of the present process, the newest last.
        cubes: the obstacles in force, of the last request that was carried out.
        clear: returns whether nothing disturbs the world.
        sure: returns whether planner and executor know the states of all actuators.
        interlock_open: returns whether an interlock is open, or was a moment ago.
        silent_after: time without a message of the executor, after which it counts as lost [s].
        bias: tip bias that the daemon tells; None: no tracker.
        shown_obstacles: number in the last state.
        losses: times at which the core heard of the ends of connections to the executor [s].
        met: whether it has met an executor since; `alone_since`: awake time of the last end, infinite while connected.
        scenes: number of scenes that workers build.
        slow: whether rounds of the planner's loop take long.
        congested: whether peers read slowly.
        simulated: whether the executor simulates its boards.
        full: whether the socket to the executor is full.
        lead: time of one stage [s]; `travel` and `rest` are the times of one actuator, of the arm's file.
        inrush: whether few actuators may switch at once, so that a stage waits for the one before.
        switched_at: time of the snapshot that showed the last switch of each actuator [s].
        made: snapshot and switching times when the planner sent its last program.
        offset: of the tracker's tips from the computed ones; `clamp` and `hold` are of the arm's file.
        tip_at: time of the last measured tip, of whatever age [s]; `good_tip_at` of the last one that surely counts.

    Args:
        wall: returns the UNIX time [s].
        driven: returns the states to which the boards drive the actuators.
    """

    def __init__(
        self, modules: JudgedModules, wall: Callable[[], float], driven: Callable[[], int], clear: Callable[[], bool]
    ) -> None:
        self.modules, self.wall, self.driven, self.clear = modules, wall, driven, clear
        self.now, self.process, self.instance = 0.0, 0, 0
        self.tolerance = self.angle_tolerance = self.length = self.longest_transition = self.lead = 0.0
        self.travel, self.rest, self.inrush = 0.0, 0.0, False
        self.silent_after = math.inf
        self.sure = clear
        self.interlock_open: Callable[[], bool] = lambda: False
        self.bias: tuple[float, ...] | None = None
        self.offset, self.clamp, self.hold = (0.0, 0.0), 0.0, 0.0
        self.slow = self.congested = self.full = self.simulated = False
        self.ledger_counts: tuple[int, ...] = ()
        self.disk_failed = False
        self.numbers = 0
        self.requests: list[Request] = []
        self.programs: dict[tuple[int, int], Ran] = {}
        self._last: dict[str, tuple[float, float]] = {}  # time and awake time of the last event of each kind
        self._still_from = self._still_until = self._still = 0.0
        self.declared = bytes([255]) * len(modules.labels)
        self.begin(0)

    def begin(self, process: int) -> None:
        if not process:  # what stood still has ended
            self._still = self.now - self.awake
            self._still_from = self._still_until = self.now
        elif self.now < self._still_until:  # it begins in a standstill, of which it does not know the first part
            self._still += self.now - self._still_from
            self._still_from = self.now
        self.process, self.began_at, self.began_awake = process, self.now, self.awake
        self.requests = []
        self.heard = deque([Heard(self.now, self.awake, None)], maxlen=1_000)  # a standstill of 20 s has 400
        self.cubes: tuple[Cube, ...] = ()
        self.cubes_number, self.cubes_at = 0, self.now
        self.quits = False
        self.tip_at = self.good_tip_at = -math.inf
        self.scenes = self.shown_obstacles = 0
        self.switched_at = [-math.inf] * len(self.modules.labels)
        self.made = dict[int, Made]()  # programs that were sent, by number
        self.setpoints = 0
        self.losses, self.met = deque[float](maxlen=50), False
        self.alone_since = self.awake
        self.counts_at_start: int | None = None
        self._tables, self._needed, self._failed = self.declared, self.declared, False

    @property
    def awake(self) -> float:
        """Time for which processes of the planner were not halted [s]."""
        return self.now - self._still - max(min(self.now, self._still_until) - self._still_from, 0.0)

    def stands_still(self, until: float) -> None:
        """The process is halted from now on until a time [s]."""
        if self.now < self._still_until:
            self._still_until = max(self._still_until, until)
        else:
            self._still += max(self._still_until - self._still_from, 0.0)
            self._still_from, self._still_until = self.now, until
        self.note("still", until)

    @property
    def reconnecting(self) -> bool:
        """Whether clients may not have reconnected after a standstill: results wait, and what follows them."""
        return (
            self._still_until - self._still_from > LEASE / 2 - 0.3 and self.now < self._still_until + RECONNECTED + 2.0
        )

    @property
    def unreached(self) -> bool:
        """Whether clients surely have not had the time to reconnect after a standstill."""
        stood = self._still_until - self._still_from
        return stood > LEASE / 2 + 0.3 and self._still_until < self.now < self._still_until + RECONNECTED - 0.3

    def turned(self, request: Request, waypoint: Payload) -> float | None:
        """Returns the orientation that a waypoint asks for; None: any serves, also if the tolerance is half a turn."""
        angle = float((request.body.get("tolerance") or {}).get("orientation") or self.angle_tolerance)
        return None if angle >= math.pi else waypoint.get("orientation")

    def sent_since(self, request: Request) -> float:
        """Returns when a request may have been sent [s]: perhaps while the process stood still."""
        stood = self._still_until - self._still_from > STOOD_STILL and request.at < self._still_until + SETTLES
        return min(request.sent_at, self._still_from) if stood else request.sent_at

    def note(self, kind: str, at: float | None = None) -> None:
        self._last[kind] = self.now if at is None else at, self.awake

    def had(self, kind: str, since: float) -> bool:
        """Returns whether there was an event of a kind since a time [s]."""
        return kind in self._last and self._last[kind][0] >= since

    def lately(self, kind: str, seconds: float) -> bool:
        """Returns whether there was an event of a kind in the last seconds that the process was awake."""
        return kind in self._last and self._last[kind][1] >= self.awake - seconds

    @property
    def full_lately(self) -> bool:
        """Whether the socket to the executor is full, or was a moment ago."""
        return self.full or self.lately("full", 0.5)

    def hears(self, snapshot: Snapshot | None) -> None:
        """The process gets a snapshot, or its connection ends."""
        before = self.heard[-1].snapshot
        if before is not None and snapshot is not None:
            changed = unpack(before.outputs) ^ unpack(snapshot.outputs)
            for k in range(len(self.switched_at)):
                if changed >> k & 1:
                    self.switched_at[k] = snapshot.at
        self.heard.append(Heard(self.now, self.awake, snapshot))

    def loses(self) -> None:
        self.note("link")
        self.alone_since = min(self.alone_since, self.awake)
        self.hears(None)

    def notices_loss(self) -> None:
        """The planner's core hears that there is no connection, perhaps for another reason than before."""
        if self.met:
            self.losses.append(self.now)
        self.met = False

    def lost_between(self, first: float, last: float) -> bool:
        """Returns whether the executor was lost between two times [s]."""
        return any(first < at < last for at in self.losses)

    def truths(self, delay: float = DELAY) -> Iterator[Heard]:
        """Yields the snapshots that held at some time in the last seconds that the process was awake, newest first."""
        since = self.awake - delay
        for heard in reversed(self.heard):
            yield heard
            if heard.awake < since:
                return

    @property
    def snapshot(self) -> Snapshot | None:
        return self.heard[-1].snapshot

    def waiting(self, *keys: str) -> list[Request]:
        return [r for r in self.requests if r.query and r.answer is None and r.key in keys]

    def ran(self, goal: str) -> list[Ran]:
        """Returns the programs of a goal's id, the oldest first."""
        return [ran for ran in self.programs.values() if ran.goal == goal]

    def needs_tables(self, snapshot: Snapshot) -> None:
        """Records for which locked states the planner needs tables."""
        everything = (1 << len(self.modules.labels)) - 1
        known, locked, measured = unpack(snapshot.known), unpack(snapshot.locked), unpack(snapshot.measured)
        if known | unpack(snapshot.homing) != everything or snapshot.moving:
            return
        held = locked & known
        needed = bytes(measured >> k & 1 if held >> k & 1 else 255 for k in range(len(self.modules.labels)))
        if needed != self._needed:
            self._needed, self._failed = needed, False
            self.note("tables")

    def takes_tables(self, locked: bytes | None) -> None:
        """Records that tables were built for locked states; None: that failed."""
        self._failed = locked is None
        self._tables = self._tables if locked is None else locked
        self.note("tables")

    def sends(self, program: int) -> None:
        """Records what the planner may know as it sends a program."""
        changing = self.building or self.scene_building or self.had("cubes", self.now - 0.1)
        cubes = set[Cube]() if changing else set[Cube].intersection(*self.in_force())
        self.made[program] = Made(self.snapshot, tuple(self.switched_at), cubes)

    @property
    def building(self) -> bool:
        """Whether the tables are not those for the present locks, or were not a moment ago."""
        return self._tables != self._needed or self.lately("tables", DELAY)

    @property
    def scene_building(self) -> bool:
        """Whether a worker builds a scene."""
        return self.scenes > 0

    @property
    def build_failed(self) -> bool:
        """Whether the last attempt to build tables has failed."""
        return self._failed or self.had("task failed", self.now - 1.0)

    @property
    def tables(self) -> bytes:
        """The locked states for which tables were built last."""
        return self._tables

    def obstacles_in_force(self) -> list[Request | None]:
        """Returns the requests whose obstacles may be in force now; None: those that were confirmed last."""
        found = list[Request | None]()
        for request in reversed(self.requests):
            regions = request.body.get("regions")
            if request.key != "obstacles" or "*" in request.name or not isinstance(regions, list):
                continue
            if request.answer is not None and not request.accepted:
                if request.answer.get("reason") == "obstacles-not-checked":
                    found.append(request)
                continue
            found.append(request)
            taken = self.awake - request.awake > TAKEN_WITHIN and not self.slow and not self.lately("still", 0.1)
            if request.accepted or (taken and not self.had("task failed", request.at)):
                return found
        return [*found, None]

    def in_force(self) -> list[set[Cube]]:
        """Returns the sets of obstacles that may be in force now."""
        return [set(self.cubes if request is None else request.cubes) for request in self.obstacles_in_force()]

    def judge_bias(self, bias: Sequence[float], text: str) -> None:
        """Compares a tip bias with that of the tracker: it is used for a while after a measured tip, and zero else."""
        length, apart = math.hypot(*bias), math.dist(bias, self.offset)
        require(length <= self.clamp + 1e-9, f"{text} has a bias of {length}")
        require(length == 0.0 or apart <= BIAS_WITHIN, f"{text} has the bias {bias}, the tracker has {self.offset}")
        silent = self.now - self.tip_at > self.hold + 2.0
        require(not silent or length == 0.0, f"{text} has the bias {bias} without a measured tip")
        fresh = TIP_TAKEN < self.now - self.good_tip_at < self.hold - 0.5
        require(not fresh or length > 0.0, f"{text} has no bias after a measured tip")

    def known_cubes(self, request: Request | None) -> set[Cube]:
        """Returns all obstacles that may be in force, or were since a request came."""
        cubes = {*self.cubes, *(() if request is None else request.among)}
        for other in self.requests:
            pending = other.answer is None or (request is not None and other.answered_at >= request.at)
            if other.key == "obstacles" and pending:
                cubes |= set(other.cubes)
        return cubes
