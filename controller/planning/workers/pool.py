"""The threads that carry out the tasks of the planner's core, and the processes for plans that may take seconds.

Such processes occupy neither the planner's threads nor the GIL.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing.connection import Connection, wait

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.signals import OF_TERMINAL, ignore
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import Answer, DescribePlan, Task
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import Abandoned, ArmModel, MakeSolver, build_scene, build_tables
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.densities import Densities

log = logging.getLogger(__name__)

THREADS: dict[str, tuple[type[Task], ...]] = {
    "goals": (tasks.PlanGoal, tasks.ImprovePlan, tasks.PrepareSearch),
    "queries": (tasks.DescribePlan,),
    "setpoints": (tasks.FollowSetpoint,),
    "checks": (tasks.CheckStages, tasks.CheckStanding, tasks.BuildScene),
    "tables": (tasks.BuildTables,),
}
LONG_PLANS = "long plans"  # threads that wait for processes
LONG = 1.0  # [s]: a plan with a later deadline is long
POLL = 0.05  # [s] between two tests whether a plan is still wanted
START = 60.0  # [s] for a process to start and to send its answer, on a busy machine
NICE = 10  # goals and set-points have priority, if the service permits a lower priority
SPAWN = multiprocessing.get_context("spawn")  # a fork would copy the locks of threads


@dataclass(eq=False)
class QueuedTask:
    """A task with its number. The core's thread sets `abandoned` and `hurried`; the worker's reads them."""

    number: int
    task: Task
    abandoned: bool = False
    hurried: bool = False

    def proceed(self) -> bool:
        """Returns whether the task must end soon. Raises Abandoned if it is no longer needed."""
        if self.abandoned:
            raise Abandoned
        return self.hurried


class Workers:
    """Carries out tasks, each kind in a thread of its own. All methods are for one thread; only `close` waits.

    Plans that may take long go to `planning.workers` processes, if there are any.
    Each task is answered by `Answered`; its last answer is marked. `post` takes the answers, in the workers' threads.
    `fatal` takes the reason after an unexpected end of a thread: the process must end. `make` makes solvers. Unless
    `threaded`, there are no threads: who has started a task calls `carry_out`.
    """

    def __init__(
        self,
        arm: Arm,
        densities: Densities,
        weights: NDArray[np.float64],
        post: Callable[[Event], None],
        fatal: Callable[[str], None],
        make: MakeSolver = Solver,
        *,
        threaded: bool = True,
    ) -> None:
        self._arm, self._densities, self._weights, self._make = arm, densities, weights, make
        self._post, self._fatal = post, fatal
        self._for_goals, self._for_queries = ArmModel(arm, "goals"), ArmModel(arm, "queries")
        self._for_setpoints = ArmModel(arm, "setpoints")
        self._queued: dict[int, QueuedTask] = {}  # unanswered tasks; a worker removes its own
        self._queues = {name: queue.SimpleQueue[QueuedTask | None]() for name in (*THREADS, LONG_PLANS)}
        self._processes = [LongPlanner(arm, weights) for _ in range(arm.settings.planning.workers)]
        carriers = [*((name, None) for name in THREADS), *((LONG_PLANS, process) for process in self._processes)]
        self.threads = [
            threading.Thread(target=self._run, args=carrier, name=carrier[0], daemon=True)
            for carrier in carriers
            if threaded
        ]
        for thread in self.threads:
            thread.start()

    def start(self, number: int, task: Task) -> None:
        """Queues a task. It waits for earlier tasks of the same thread: abandon less urgent ones."""
        self._queued[number] = queued = QueuedTask(number, task)
        apart = self._processes and isinstance(task, DescribePlan) and (task.goal.message.deadline or 0.0) > LONG
        name = LONG_PLANS if apart else next(name for name, kinds in THREADS.items() if isinstance(task, kinds))
        self._queues[name].put(queued)

    def abandon(self, number: int) -> None:
        """Makes a task end soon; a task that has not begun is answered by `Done` when its turn comes."""
        if (queued := self._queued.get(number)) is not None:
            queued.abandoned = True

    def hurry(self, number: int) -> None:
        if (queued := self._queued.get(number)) is not None:
            queued.hurried = True

    def close(self, timeout: float = 2.0) -> None:
        """Abandons all tasks and ends the threads; one that does not end within `timeout` [s] ends with the process."""
        for queued in list(self._queued.values()):
            queued.abandoned = True
        for thread in self.threads:
            self._queues[thread.name].put(None)
        until = time.monotonic() + timeout
        for thread in self.threads:
            thread.join(max(until - time.monotonic(), 0.0))
        for process in self._processes:
            process.close()

    # --- the workers' threads

    def _run(self, name: str, process: LongPlanner | None) -> None:
        try:
            while self.carry_out(name, process):
                pass
        except BaseException as error:  # also SystemExit, which would end a thread silently
            log.critical("the thread for %s has ended", name, exc_info=True)
            self._fatal(f"the planner's thread for {name} has ended: {error!r}")

    def carry_out(self, name: str, process: LongPlanner | None = None) -> bool:
        """Waits for the next task of a thread, and posts its answers; returns False if there are no more tasks."""
        if (queued := self._queues[name].get()) is None:
            return False
        last = self._answer(queued, process)
        self._queued.pop(queued.number, None)
        self._post(Answered(queued.number, last, True))
        return True

    def _answer(self, queued: QueuedTask, process: LongPlanner | None) -> Answer:
        """Posts all answers to a task but the last one, which it returns. Never raises an Exception."""
        try:
            queued.proceed()
            answer = self._perform(queued, process)
            if not isinstance(answer, Iterator):
                return answer
            for part in answer:
                self._post(Answered(queued.number, part, False))
        except Abandoned:
            pass
        except Refusal as refusal:
            return refusal.data
        except Exception as error:
            log.exception("the task %s failed", type(queued.task).__name__)
            return tasks.Failed(traceback.format_exception_only(error)[-1].strip())
        return tasks.Done()

    def _perform(self, queued: QueuedTask, process: LongPlanner | None) -> Answer | Iterator[Answer]:
        match task := queued.task:
            case tasks.PlanGoal():
                return computations.plan_goal(self._for_goals, task, queued.proceed)
            case tasks.ImprovePlan():
                return computations.improve(self._for_goals, task, queued.proceed)
            case tasks.PrepareSearch():
                return computations.prepare_search(self._for_goals, task, queued.proceed)
            case tasks.DescribePlan() if process is not None:
                return process.plan(task, queued.proceed)
            case tasks.DescribePlan():

                def hurry() -> bool:  # a query ends early if it is abandoned, a goal is planned, or another query waits
                    goal = any(isinstance(other.task, tasks.PlanGoal) for other in list(self._queued.values()))
                    return queued.abandoned or goal or not self._queues["queries"].empty()

                return computations.describe(self._for_queries, task, queued.proceed, hurry)
            case tasks.FollowSetpoint():
                return computations.follow(self._for_setpoints, task)
            case tasks.CheckStages():
                return computations.check_stages(task, queued.proceed)
            case tasks.CheckStanding():
                return computations.check_standing(task)
            case tasks.BuildScene():
                return build_scene(self._arm, task)
            case tasks.BuildTables():
                return build_tables(self._arm, self._densities, self._weights, task, self._make)


# --- plans in a process of their own


class LongPlanner:
    """A process that plans. It is killed with an unwanted plan, and another one starts at once."""

    def __init__(self, arm: Arm, weights: NDArray[np.float64]) -> None:
        self._arguments = arm, weights, version("hyperbit")
        self._start()

    def plan(self, task: DescribePlan, proceed: Callable[[], object]) -> Answer:
        """Returns the answer to a task; calls `proceed` repeatedly, which may raise."""
        until = time.monotonic() + START + task.seconds
        try:
            self._connection.send(packed(task))
            while not self._connection.poll(POLL):
                proceed()
                if time.monotonic() > until:
                    raise TimeoutError(f"no answer after {START + task.seconds:g} s")
            answer: Answer = self._connection.recv()
        except (EOFError, OSError) as error:
            self._restart()
            log.error("the process for long plans has failed, another one starts: %r", error)
            return tasks.Failed(f"the process for long plans has failed: {error!r}")
        except BaseException:
            self._restart()
            raise
        if isinstance(answer, tasks.Failed):
            log.error("a long plan has failed: %s", answer.reason)
        return answer

    def close(self) -> None:
        self._connection.close()
        self.process.kill()
        self.process.join()

    def _restart(self) -> None:
        self.close()
        self._start()

    def _start(self) -> None:
        """Starts the process, which needs seconds; plans wait for it."""
        self._connection, theirs = SPAWN.Pipe()
        self.process = SPAWN.Process(target=serve, args=(theirs, *self._arguments), name="long plans", daemon=True)
        self.process.start()
        theirs.close()


def packed(task: DescribePlan) -> DescribePlan:
    """Returns a task for another process, which builds its own tables and scene."""
    start, tables, scene = task.goal.basis
    basis = tasks.Basis(start, tables._replace(solvers=None), scene._replace(keep_out=scene.keep_out.sent))
    return task._replace(goal=task.goal._replace(basis=basis))


# --- the other process


def serve(connection: Connection, arm: Arm, weights: NDArray[np.float64], expected: str) -> None:
    ignore(OF_TERMINAL)  # the planner ends this process
    threading.Thread(target=end_with_parent, daemon=True).start()
    with contextlib.suppress(OSError):
        os.nice(NICE)
    planner = PlanServer(arm, weights)
    planner.prepare(arm.locked.astype(np.uint8).tobytes())
    answer_plans(connection, planner, expected)


def answer_plans(connection: Connection, planner: PlanServer, expected: str) -> None:
    """Answers each plan that arrives, until the connection ends; refuses all if this is not the expected version.

    An upgrade replaces the package under a running daemon.
    """
    found = version("hyperbit")
    other = tasks.Failed(f"the daemon is hyperbit {expected}, installed is {found}: restart the daemon")
    with contextlib.suppress(EOFError, OSError):
        while True:
            plan = connection.recv()
            connection.send(planner.answer(plan) if found == expected else other)


def end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        wait([parent.sentinel])
        os._exit(1)


class PlanServer:
    def __init__(self, arm: Arm, weights: NDArray[np.float64]) -> None:
        self._arm, self._weights, self._model = arm, weights, ArmModel(arm, "queries")
        self._densities: Densities | None = None
        self._tables: tasks.Tables | None = None
        self._scene: tasks.VersionedScene | None = None

    def answer(self, task: DescribePlan) -> Answer:
        try:
            start, tables, scene = task.goal.basis
            if self._scene is None or self._scene.generation != scene.generation:
                self._scene = build_scene(self._arm, tasks.BuildScene(scene.generation, scene.keep_out)).scene
            basis = tasks.Basis(start, self.prepare(tables.locked), self._scene)
            task = task._replace(goal=task.goal._replace(basis=basis))
            return computations.describe(self._model, task, lambda: False, lambda: False)
        except Refusal as refusal:
            return refusal.data
        except Exception:
            return tasks.Failed(traceback.format_exc())

    def prepare(self, locked: bytes) -> tasks.Tables:
        """Returns the tables for locked states; reuses those of the latest plan if they match."""
        arm, known = self._arm, self._tables
        if self._densities is None:
            self._densities = load_or_map(arm.reduced, arm.pixel, arm.level_pixels, default_directory())
        if known is None or known.locked != locked:
            number = 0 if known is None else known.generation + 1
            self._tables = known = build_tables(arm, self._densities, self._weights, tasks.BuildTables(number, locked))
        return known
