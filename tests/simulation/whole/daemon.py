"""The whole daemon without its executor: the planner's processes, their service manager, and their clients."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from random import Random

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.workers.computations import MakeSolver
from hyperbit.controller.program import Counted, Diagnostics, Snapshot, Up
from hyperbit.controller.search.lists.two_list import ListSizes
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess
from tests.simulation.network import Network
from tests.simulation.statements.account import Account
from tests.simulation.statements.asked import Payload, Request, states_from
from tests.simulation.statements.exchange import Exchange
from tests.simulation.whole.clients import Clients
from tests.simulation.whole.configurations import Configurations
from tests.simulation.whole.planner_process import LEASE, UNIX, PlannerProcess
from tests.simulation.whole.planner_witness import PlannerWitness
from tests.simulation.whole.storage import Storage
from tests.simulation.whole.workers import LookClock, Mood
from tests.simulation.whole.zenoh_model import LATENCY, TRANSMITTED, Sent, ZenohModel

OFFSET = 4e-4  # of measured tips from computed ones; less than the tolerance
LOOKS = 1e-6, 1e-6, 1e-5, 1e-4, 5e-4  # [s] that the first look at the clock in a task counts
SIZES = (  # None: the arm is listed whole
    None,
    ListSizes(4, 8, 16, 4, 4, 64, 2),
    ListSizes(8, 12, 16, 4, 4, 64, 2),
    ListSizes(8, 16, 32, 16, 16, 256, 4),
    ListSizes(16, 24, 32, 8, 8, 256, 8),
    ListSizes(8, 16, 32, 4, 4, 64, 2, 4, 12),
)
MARKS = 5  # two goals have six: of acceptances, of published results, and of recorded ones
STANDSTILL = 1.0  # [s] of a halt, after which results may wait for clients to reconnect
COUNTED_WITHIN = 0.5  # [s] from the executor's counts to the ledger


class Daemon:
    """The planner's side of the world.

    Attributes:
        process: the present process of the planner; None between two.
        storage: the files, which survive the processes.
        state: the last payload of `state`; None without a process.
        results: payloads of results, by id.
        snapshot: the latest that came from the executor; None without a connection.
        together: the service manager ends the executor with the planner.
        wanted: whether a goal was sent while all is calm.
        awake_since: time when the last halt of the process ended [s].
        offset: of measured tips from computed ones.
        slow: longest time of a round of the loop [s].
        congestion: longest time that a message of the outbox waits for a peer that reads slowly [s].

    Args:
        drawn: returns random numbers for a purpose.
        simulated: whether the executor simulates its boards.
    """

    def __init__(
        self,
        executed: ExecutedArm,
        arm: Arm,
        agenda: Agenda,
        drawn: Callable[[str], Random],
        executor: ExecutorProcess,
        note: Callable[[object], None],
        simulated: bool,
        account: Account,
    ) -> None:
        self.executed, self.arm, self.agenda, self.pace = executed, arm, agenda, pace_of(arm.settings)
        weights = drawn("weights")
        self.weights = [weights.choice([1.0, 1.0, 2.0, 3.0]) for _ in executed.actuators]
        angle = drawn("tracker").uniform(-math.pi, math.pi)
        self.offset = (OFFSET * math.cos(angle), OFFSET * math.sin(angle))
        self.space = Configurations(arm.manipulator, executed.most, self.weights, arm.settings.body_radius)
        self.network = self.connection = Network(executed.name, agenda, drawn("network"), executor)
        self.storage, self.mood = Storage(executed.actuators, drawn("storage")), Mood()
        self.search_clock = LookClock(agenda, weights.choice(LOOKS))
        self.solver = self._capped(weights.choice(SIZES))
        self.densities = map_densities(arm.reduced, arm.pixel, arm.level_pixels)
        self.state: Payload | None = None
        self.results: dict[str, Payload] = {}
        self.snapshot: Snapshot | None = None
        self.counts: Counter[str] = Counter()
        self._counted = deque[tuple[float, tuple[int, ...]]](maxlen=10)
        self._executor, self._random, self._note = executor, drawn("daemon"), note
        self.together, self.wanted = self._random.random() < 0.3, False
        self._errs = self._random.choice([0.0, 0.0, 0.3])
        self.awake_since, self.slow, self.congestion, self._offset = 0.0, 0.0, 0.0, UNIX
        self.exchange = Exchange(account, self)
        self.simulated = simulated
        self.witness = PlannerWitness(self.exchange, note)
        self.zenoh = ZenohModel(agenda, drawn("zenoh"), self, lambda: self.awake_since)
        self.clients = Clients(self, drawn("clients"))
        self.process: PlannerProcess | None = None
        self._processes = 0
        self.network.wake, self.network.hears, self.network.sends = self._readable, self._hears, self.exchange.writes
        agenda.after(0.0, self.start)

    def _capped(self, sizes: ListSizes | None) -> MakeSolver:
        """Returns how solvers are made: they list the arm whole, or have lists of some sizes."""

        def make(manipulator: Manipulator, densities: Densities, weights: NDArray[np.float64]) -> Solver:
            solver = Solver(manipulator, densities, weights, list_whole=sizes is None, list_sizes=sizes or ListSizes())
            solver.clock = self.search_clock
            return solver

        return make

    def start(self) -> None:
        if self.process is None:
            self._processes += 1
            self.exchange.begins(self._processes)
            self.process = PlannerProcess(self, self._processes, self._random)

    def planner_ended(self) -> None:
        """Starts the next process after a while; ends the executor, if it belongs to the same service."""
        self._note("the planner is dead")
        self.counts["planners that ended"] += 1
        self.process, self.state, self.snapshot = None, None, None
        self.exchange.begins(0)
        if self.together:
            self._executor.quit()
        self.exchange.stands_still()
        self.awake_since = min(self.awake_since, self.agenda.now)
        self.agenda.after(self._random.choice([0.2, 1.0, 3.0]), self.start)

    def fails(self, reason: str) -> None:
        self._note(("planner fails", reason))
        self.counts["planners that failed"] += 1

    def _readable(self) -> None:
        if self.process is not None:
            self.process.wake_soon()

    def _hears(self, message: Up | None) -> None:
        self.exchange.hears(message)
        if message is None:
            self.snapshot = None
            return
        if isinstance(message, Snapshot):
            self.snapshot = message
        if isinstance(message, Counted | Diagnostics):
            self._counted.append((self.agenda.now, message.counts))

    @property
    def counted(self) -> tuple[int, ...]:
        """The executor's counts of switches that came more than a moment ago."""
        old = [counts for at, counts in self._counted if at < self.agenda.now - COUNTED_WITHIN]
        return old[-1] if old and old[-1] else self.storage.counts

    def wall(self) -> float:
        """Returns the wall clock [UNIX s]."""
        return self.agenda.now + self._offset

    def arrives(self, sent: Sent, key: str) -> Request:
        self.counts[f"asked {key}"] += 1
        self._note(("arrives", sent.client, key, sent.name, sent.payload, sent.attachment, sent.query))
        request = self.exchange.arrives(key, sent.name, sent.query, sent.payload, sent.attachment)
        request.drawn = sent.drawn
        return request

    def replies(self, request: object, data: bytes) -> None:
        assert isinstance(request, Request)
        self._note(("replies", request.number, request.key, data[:400]))
        answer = msgspec.json.decode(data)
        if "accepted" in answer:
            self.counts[f"{request.key} {'accepted' if answer['accepted'] else 'refused'}"] += 1
        self.exchange.replies(request, answer)

    def publishes(self, key: str, data: bytes) -> None:
        self.counts[f"published {key}"] += 1
        if key == "state":
            self.state = msgspec.json.decode(data)
        elif key == "result":
            payload = msgspec.json.decode(data)
            self.counts[f"result {payload['status']}"] += 1
            self.results[payload["id"]] = payload
        if key in ("result", "feedback"):
            self._note((key, data))
        self.exchange.publishes(key, msgspec.json.decode(data))

    def ends_in_order(self) -> None:
        self.counts["planners that quit"] += 1
        self.exchange.ends_in_order()

    @property
    def awake(self) -> bool:
        """Whether a process runs and is not halted."""
        return self.process is not None and self.agenda.now >= self.awake_since

    def stall(self, seconds: float) -> None:
        """Halts the process for a time [s]; what is sent to it waits."""
        self.exchange.stands_still()
        self.awake_since = max(self.awake_since, self.agenda.now + seconds)
        self.exchange.note("halt", self.awake_since)
        if seconds > STANDSTILL:
            self.exchange.note("standstill", self.awake_since)
        if seconds > LEASE:
            self.exchange.stood_still(self.awake_since)

    def slow_down(self) -> None:
        """Makes the loop's thread busy for a while after a round."""
        if self.slow:
            self.stall(self._random.uniform(0.0, self.slow))

    def die(self) -> None:
        """Kills the process soon, perhaps in the middle of a step, or while a result is published or recorded."""
        if self.process is not None and self._random.random() < 0.3:
            self.process.kill_after(self._random.choice([0, 1, 2, 3, 5, 10, 30]))
        elif self.process is not None:
            self._die_at_mark(self.process, self._random.randrange(MARKS))

    def _die_at_mark(self, process: PlannerProcess, left: int) -> None:
        """Kills a process at the next mark or record, or after `left` further ones."""

        def marked() -> None:
            if left:
                self._die_at_mark(process, left - 1)
            else:
                process.marked = lambda: None
                self.agenda.after(
                    self._random.choice([0.0, 0.0, 1.5 * TRANSMITTED]) * self._random.random(), process.kill
                )

        process.marked = marked

    def end_in_order(self) -> None:
        """Asks the process to end, perhaps while requests arrive."""
        if self.process is None:
            return
        if not self.clients.calm and self._random.random() < 0.7:
            self.clients.rush()
        process = self.process
        self.agenda.after(self._random.uniform(0.0, 3 * LATENCY), process.quit)

    def err(self, share: float) -> None:
        """Makes a share of the plans end before their goal."""
        self.mood.errs = share

    def lose_network(self, lost: bool) -> None:
        """Loses the connections to all peers, or brings them back."""
        self.zenoh.lost = lost

    def fill_disk(self, records: int) -> None:
        """Makes the disk full after some further records."""
        self.storage.fill(records)
        self.exchange.note("disk")

    def hold_up(self, slow: float = 0.0, congestion: float = 0.0) -> None:
        """Slows the loop's rounds [s], or lets clients read slowly [s]."""
        self.slow, self.congestion = slow, congestion

    def fill_socket(self, places: int) -> None:
        """Makes the socket to the executor full after some packets."""
        self.network.fill(places)

    def drain_socket(self) -> None:
        self.network.drain()

    def set_clock(self, by: float) -> None:
        self._offset += by
        self.exchange.note("clock")

    def mend(self) -> None:
        """Ends all faults; a halt continues to its end."""
        self.mood.mend()
        self.mood.errs = 0.0
        self.hold_up()
        self.lose_network(False)
        self.drain_socket()
        if self.storage.room is not None:
            self.exchange.note("disk")
        self.storage.fill(None)
        if self.process is not None:
            self.process.actions_left, self.process.marked = None, lambda: None
            self.process.ledger.write()

    def be_calm(self, calm: bool) -> None:
        self.clients.calm, self.wanted = calm, False
        self.mood.errs = 0.0 if calm else self._errs

    @property
    def hindered(self) -> bool:
        """Whether something may delay answers: network, disk, socket, loop, clients or workers."""
        held_up = self.slow > 0.0 or self.congestion > 0.0 or self.zenoh.lost or self.network.full
        late = self.mood.disturbed or (self.process is not None and self.process.workers.late)
        return held_up or late or self.storage.room is not None

    @property
    def calm(self) -> bool:
        """Whether clients only do what makes the arm ready."""
        return self.clients.calm

    @property
    def at_rest(self) -> bool:
        """Whether the planner says that the arm is ready, and everybody has an answer."""
        if self.state is None or self.state["mode"] != "ready" or self.snapshot is None or self.process is None:
            return False
        known = states_from(self.snapshot) in self.space.index
        return known and not self.exchange.unanswered() and not self.exchange.confirmed
