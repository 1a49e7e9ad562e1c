"""The whole daemon without its executor: the planner's processes, their service manager, and their clients."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from random import Random

import numpy as np

from controller.arm.arm import Arm
from controller.executor.core.arm import ExecutedArm
from controller.host.process import Quit
from controller.motion.decoding.goal import GoalRules, schedule
from controller.motion.stages.pacing import pace_of
from controller.program import Snapshot, unpack
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess
from tests.simulation.network import Network
from tests.simulation.whole.clients import Clients
from tests.simulation.whole.configurations import Configurations
from tests.simulation.whole.exact_search import ExactSearch
from tests.simulation.whole.history import Beginning, History
from tests.simulation.whole.planner_process import UNIX, PlannerProcess
from tests.simulation.whole.planner_storage import Storage
from tests.simulation.whole.searcher import Mood


class Daemon:
    """The planner's side of the world.

    Attributes:
        process: the present process of the planner; None between two.
        clients: ask it.
        connection: its connections to the executor.
        history: of all processes.
        storage: what survives them.
        mood: of its workers.
        together: the service manager ends the executor with the planner.
        wanted: whether a goal was sent while all is calm.
        awake_since: time when the last halt of the process ended [s].
        slow: longest time of a round of the loop [s].

    Args:
        executed: the arm of the executor.
        arm: the same arm of the planner.
        agenda: time and events.
        drawn: returns random numbers for a purpose.
        executor: the executor's process.
        note: takes events for the story.
    """

    def __init__(
        self,
        executed: ExecutedArm,
        arm: Arm,
        agenda: Agenda,
        drawn: Callable[[str], Random],
        executor: ExecutorProcess,
        note: Callable[[object], None],
    ) -> None:
        self.executed, self.arm, self.agenda, self.pace = executed, arm, agenda, pace_of(arm.settings)
        self.space = Configurations(arm.manipulator, executed.most)
        self.network = self.connection = Network(executed.name, agenda, drawn("network"), executor)
        self.history, self.storage, self.mood = History(agenda, note), Storage(len(executed.actuators)), Mood()
        self.search = ExactSearch(arm, self.space, drawn("search"))
        self._executor, self._random = executor, drawn("daemon")
        self.together, self.wanted = self._random.random() < 0.3, False
        self.awake_since, self.slow, self._offset = 0.0, 0.0, UNIX
        self.clients = Clients(self, drawn("clients"))
        self.process: PlannerProcess | None = None
        self._processes = 0
        self.network.wake = self._readable
        agenda.after(0.0, self.start)

    # --- the process and its service manager

    def start(self) -> None:
        """Starts a process if none runs."""
        if self.process is None:
            self._processes += 1
            self.process = PlannerProcess(self, self._processes, self._random)

    def planner_ended(self) -> None:
        """Starts the next process after a while; ends the executor, if it belongs to the same service."""
        self.process = None
        self.history.ended()
        if self.together:
            self._executor.post(Quit())
        self.awake_since = min(self.awake_since, self.agenda.now)
        self.agenda.after(self._random.choice([0.2, 1.0, 3.0]), self.start)

    def _readable(self) -> None:
        if self.process is not None:
            self.process.wake_soon()

    def wall(self) -> float:
        """Returns the wall clock [UNIX s]."""
        return self.agenda.now + self._offset

    # --- troubles

    @property
    def awake(self) -> bool:
        """Whether a process runs and is not halted."""
        return self.process is not None and self.agenda.now >= self.awake_since

    def stall(self, seconds: float) -> None:
        """Halts the process for a time [s]; what is sent to it waits."""
        self.awake_since = max(self.awake_since, self.agenda.now + seconds)

    def slow_down(self) -> None:
        """Makes the loop's thread busy for a while after a round."""
        if self.slow:
            self.stall(self._random.uniform(0.0, self.slow))

    def die(self) -> None:
        """Kills the process soon, perhaps in the middle of a step."""
        if self.process is not None:
            self.process.kill_after(self._random.choice([0, 1, 2, 3, 5, 10, 30]))

    def end_in_order(self) -> None:
        """Asks the process to end."""
        if self.process is not None:
            self.history.quits_at = self.agenda.now
            self.process.quit()

    def set_clock(self) -> None:
        """Changes the wall clock."""
        self._offset += self._random.choice([-3600.0, -0.1, 0.1, 3600.0])

    def mend(self) -> None:
        """Ends all faults; a halt continues to its end."""
        self.mood.mend()
        self.slow, self.storage.full = 0.0, False
        if self.process is not None:
            self.process._actions_left = None
            self.process.ledger.flush()

    def be_calm(self, calm: bool) -> None:
        """Makes the clients calm."""
        self.clients.calm, self.wanted = calm, False

    # --- for the invariants

    @property
    def number(self) -> int:
        """Number of the present process; 0 between two."""
        return 0 if self.process is None else self.process.number

    def unsure(self, lying: int) -> bool:
        """Returns whether planner and executor may know another state of an actuator than the real one."""
        snapshot = self.snapshot
        return bool(lying) or snapshot is None or (not snapshot.moving and snapshot.measured != snapshot.outputs)

    def least_cost(self, beginning: Beginning, bias: Sequence[float] | None) -> float:
        """Returns the least cost of a goal from where the arm was; infinite if there is none."""
        message, manipulator = beginning.message, self.arm.manipulator
        tolerances = self.arm.tolerance, self.arm.angle_tolerance
        rules = GoalRules(manipulator.dimension, *tolerances, self.pace, manipulator)
        trajectory = schedule(message, rules, message.stamp or self.wall())
        wanted = self.search.wanted(trajectory.corrected(None if bias is None else np.array(bias)))
        graph = self.space.graph(beginning.locked, beginning.states, beginning.cubes)
        start = self.space.index.get(beginning.states)
        return math.inf if start is None else self.space.optimum(graph, start, wanted)

    # --- as the planner of a world

    @property
    def snapshot(self) -> Snapshot | None:
        """The latest snapshot that the core took; None without a connection."""
        return self.history.snapshot

    @property
    def at_rest(self) -> bool:
        """Whether the planner says that the arm is ready, and everybody has an answer."""
        history = self.history
        ready = history.state is not None and history.state["mode"] == "ready" and self.snapshot is not None
        ready = ready and self.snapshot is not None and unpack(self.snapshot.measured) in self.space.index
        process = self.process
        return ready and process is not None and not process.loop.unanswered and not history.cubes
