"""The whole daemon without its executor: the planner's processes, their service manager, and their clients."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from random import Random

import msgspec

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.core.events import Payload, Record
from hyperbit.controller.program import Counted, Diagnostics, Down, PlayableFaults, Snapshot, Up
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess
from tests.simulation.judge.interface.facts import Request
from tests.simulation.judge.interface.grounds import planned_from
from tests.simulation.judge.interface.interface import InterfaceJudge
from tests.simulation.judge.interface.results import unanswered
from tests.simulation.network import Network
from tests.simulation.whole.claims import check_claims
from tests.simulation.whole.clients import Clients
from tests.simulation.whole.configurations import Configurations
from tests.simulation.whole.exact_search import ExactSearch
from tests.simulation.whole.planner_process import UNIX, PlannerProcess
from tests.simulation.whole.planner_storage import Storage, nothing
from tests.simulation.whole.planner_witness import PlannerWitness
from tests.simulation.whole.saved_poses import SavedPoses
from tests.simulation.whole.searcher import Mood
from tests.simulation.whole.zenoh_model import LATENCY, TRANSMITTED, Sent, ZenohModel

OFFSET = 4e-4  # of measured tips from computed ones; less than the tolerance
COUNTED_WITHIN = 0.5  # [s] from the executor's counts to the ledger


class Daemon:
    """The planner's side of the world.

    Attributes:
        process: the present process of the planner; None between two.
        saved: the saved poses, which survive the processes.
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
        simulation: faults that can be played in simulated boards; None: the boards count as real.
    """

    def __init__(
        self,
        executed: ExecutedArm,
        arm: Arm,
        agenda: Agenda,
        drawn: Callable[[str], Random],
        executor: ExecutorProcess,
        note: Callable[[object], None],
        judge: Callable[[Daemon], InterfaceJudge],
        simulation: PlayableFaults | None,
    ) -> None:
        self.executed, self.arm, self.agenda, self.pace = executed, arm, agenda, pace_of(arm.settings)
        weights = drawn("weights")
        self.weights = [weights.choice([1.0, 1.0, 2.0, 3.0]) for _ in executed.actuators]
        angle = drawn("tracker").uniform(-math.pi, math.pi)
        self.offset = (OFFSET * math.cos(angle), OFFSET * math.sin(angle))
        self.space = Configurations(arm.manipulator, executed.most, self.weights)
        self.network = self.connection = Network(executed.name, agenda, drawn("network"), executor)
        self.storage, self.mood = Storage(len(executed.actuators)), Mood()
        self.search = ExactSearch(arm, self.space, drawn("search"))
        self.search.erred = self._search_errs
        self.state: Payload | None = None
        self.results: dict[str, Payload] = {}
        self.snapshot: Snapshot | None = None
        self.counts: Counter[str] = Counter()
        self._counted = deque[tuple[float, tuple[int, ...]]](maxlen=10)
        self._executor, self._random, self._note = executor, drawn("daemon"), note
        self.together, self.wanted = self._random.random() < 0.3, False
        self._errs = self._random.choice([0.0, 0.0, 0.3])
        self.awake_since, self.slow, self.congestion, self._offset = 0.0, 0.0, 0.0, UNIX
        self.judge = judge(self)
        self.simulated, self.judge.gateway.playable = simulation is not None, simulation
        self.judge.account.simulated = self.simulated
        self.witness = PlannerWitness(self.judge, agenda, self.mood, note)
        self.zenoh = ZenohModel(agenda, drawn("zenoh"), self, lambda: self.awake_since)
        self._claims = drawn("claims")
        self.saved = SavedPoses(drawn("poses"), self.judge.gateway)
        self.judge.gateway.recorded = self.zenoh.matching.matching
        self.clients = Clients(self, drawn("clients"))
        self.process: PlannerProcess | None = None
        self._processes = 0
        self.network.wake, self.network.hears = self._readable, self._hears
        self.network.sends = self._sends
        agenda.after(0.0, self.start)

    def start(self) -> None:
        if self.process is None:
            self._processes += 1
            self.judge.at(self.agenda.now)
            self.judge.account.ledger_counts = self.storage.counts
            self.judge.begins(self._processes)
            check_claims(self._claims)
            self.process = PlannerProcess(self, self._processes, self._random)
            self.process.searcher.watch = self.witness.task_ends

    def planner_ended(self) -> None:
        """Starts the next process after a while; ends the executor, if it belongs to the same service."""
        self._note("the planner is dead")
        self.counts["planners that ended"] += 1
        self.process, self.state, self.snapshot = None, None, None
        self.judge.at(self.agenda.now)
        self.judge.begins(0)
        if self.together:
            self._executor.quit()
        self.awake_since = min(self.awake_since, self.agenda.now)
        self.agenda.after(self._random.choice([0.2, 1.0, 3.0]), self.start)

    def fails(self, reason: str) -> None:
        self._note(("planner fails", reason))
        self.counts["planners that failed"] += 1

    def _readable(self) -> None:
        if self.process is not None:
            self.process.wake_soon()

    def _hears(self, message: Up | None) -> None:
        self.judge.at(self.agenda.now)
        if message is None:
            self.snapshot = None
            self.judge.disconnected()
            return
        if isinstance(message, Snapshot):
            self.snapshot = message
        if isinstance(message, Counted | Diagnostics):
            self._counted.append((self.agenda.now, message.counts))
        self.judge.hears(message)

    def _sends(self, message: Down) -> None:
        self.judge.at(self.agenda.now)
        self.judge.link.sends(message)

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
        self.judge.at(self.agenda.now)
        return self.judge.arrives(sent, key)

    def unserved(self, sent: Sent) -> None:
        """Takes a message on a key that the process has not declared."""
        self.judge.at(self.agenda.now)
        self.judge.gateway.unserved(sent.name)

    def replies(self, request: object, data: bytes) -> None:
        assert isinstance(request, Request)
        self._note(("replies", request.number, request.key, data[:400]))
        answer = msgspec.json.decode(data)
        if "accepted" in answer:
            self.counts[f"{request.key} {'accepted' if answer['accepted'] else 'refused'}"] += 1
        self.judge.at(self.agenda.now)
        self.judge.replies(request, data)

    def publishes(self, key: str, data: bytes) -> None:
        self.counts[f"published {key}"] += 1
        self.judge.at(self.agenda.now)
        if key == "state":
            self.state = msgspec.json.decode(data)
        elif key == "result":
            payload = msgspec.json.decode(data)
            self.counts[f"result {payload['status']}"] += 1
            self.results[payload["id"]] = payload
        if key in ("result", "feedback"):
            self._note((key, data))
        self.judge.publishes(key, data)

    def ends_in_order(self) -> None:
        self.counts["planners that quit"] += 1
        self.judge.ends_in_order()

    def record(self, record: Record) -> None:
        row = self.storage.rows[record.identity]
        if record.ended is not None and row.accepted is not None:
            self.judge.at(self.agenda.now)
            self.judge.recorded(row.accepted.goal, record.ended.status)

    @property
    def awake(self) -> bool:
        """Whether a process runs and is not halted."""
        return self.process is not None and self.agenda.now >= self.awake_since

    def stall(self, seconds: float) -> None:
        """Halts the process for a time [s]; what is sent to it waits."""
        self.awake_since = max(self.awake_since, self.agenda.now + seconds)
        self.judge.at(self.agenda.now)
        self.judge.account.stands_still(self.awake_since)

    def slow_down(self) -> None:
        """Makes the loop's thread busy for a while after a round."""
        if self.slow:
            self.stall(self._random.uniform(0.0, self.slow))

    def die(self) -> None:
        """Kills the process soon, perhaps in the middle of a step, or while its next result leaves."""
        if self.process is not None and self._random.random() < 0.5:
            self.process.kill_after(self._random.choice([0, 1, 2, 3, 5, 10, 30]))
        elif self.process is not None:
            self.storage.marked = self._die_with_result

    def _die_with_result(self) -> None:
        process, self.storage.marked = self.process, nothing
        if process is not None:
            self.agenda.after(self._random.uniform(0.0, 1.5 * TRANSMITTED), process.kill)

    def end_in_order(self) -> None:
        """Asks the process to end, perhaps while requests arrive."""
        if self.process is None:
            return
        if not self.clients.calm and self._random.random() < 0.7:
            self.clients.rush()
        process = self.process
        self.agenda.after(self._random.uniform(0.0, 3 * LATENCY), process.quit)

    def _search_errs(self) -> None:
        self.judge.at(self.agenda.now)
        self.judge.account.note("search errs")

    def lose_network(self, lost: bool) -> None:
        """Loses the connections to all peers, or brings them back."""
        self.zenoh.lost = lost
        self.judge.at(self.agenda.now)
        self.judge.warnings.network(lost)

    def fill_disk(self, records: int) -> None:
        """Makes the disk full after some further records."""
        self.storage.fills_at = records
        self.saved.fill(True)
        self.judge.account.note("disk", self.agenda.now + 4.0)
        self.judge.account.disk_failed = True

    def hold_up(self, slow: float = 0.0, congestion: float = 0.0) -> None:
        """Slows the loop's rounds [s], or lets clients read slowly [s]."""
        self.slow, self.congestion = slow, congestion
        account = self.judge.account
        account.slow, account.congested = slow > 0.0, congestion > 0.0
        account.note("slow")
        account.note("congested")

    def fill_socket(self, places: int) -> None:
        """Makes the socket to the executor full after some packets."""
        self.network.fill(places)
        self.judge.at(self.agenda.now)
        self.judge.account.full = True

    def drain_socket(self) -> None:
        self.judge.at(self.agenda.now)
        self.judge.account.full = False
        self.judge.account.note("full")
        self.network.drain()

    def set_clock(self) -> None:
        by = self._random.choice([-3600.0, -1.0, -0.1, 0.1, 1.0, 3600.0])
        self._offset += by
        self.judge.at(self.agenda.now)
        self.judge.warnings.clock_set(by)
        self.judge.account.note("clock")

    def mend(self) -> None:
        """Ends all faults; a halt continues to its end."""
        self.mood.mend()
        self.search.errs, self.storage.marked = 0.0, nothing
        self.hold_up()
        self.lose_network(False)
        self.drain_socket()
        self.storage.full, self.storage.fills_at = False, None
        self.saved.fill(False)
        if self.process is not None:
            self.process.actions_left = None
            self.process.ledger.flush()
            self.judge.warnings.ledger(self.process.ledger.waits)

    def be_calm(self, calm: bool) -> None:
        self.clients.calm, self.wanted = calm, False
        self.search.errs = 0.0 if calm else self._errs

    @property
    def at_rest(self) -> bool:
        """Whether the planner says that the arm is ready, and everybody has an answer."""
        if self.state is None or self.state["mode"] != "ready" or self.snapshot is None or self.process is None:
            return False
        known = planned_from(self.snapshot) in self.space.index
        return known and not unanswered(self.judge.account) and not self.judge.account.cubes
