"""The threads that carry out the tasks of the planner's core."""

import logging
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import Answer, Task
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import Abandoned, ArmModel, build_scene, build_tables
from hyperbit.controller.planning.workers.long_plans import LongPlanner, is_long
from hyperbit.controller.refusals.refusal import Refusal
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
    `fatal` takes the reason after an unexpected end of a thread: the process must end.
    """

    def __init__(
        self,
        arm: Arm,
        densities: Densities,
        weights: NDArray[np.float64],
        post: Callable[[Event], None],
        fatal: Callable[[str], None],
    ) -> None:
        self._arm, self._densities, self._weights, self._post, self._fatal = arm, densities, weights, post, fatal
        self._for_goals, self._for_queries = ArmModel(arm, "goals"), ArmModel(arm, "queries")
        self._for_setpoints = ArmModel(arm, "setpoints")
        self._queued: dict[int, QueuedTask] = {}  # unanswered tasks; a worker removes its own
        self._queues = {name: queue.SimpleQueue[QueuedTask | None]() for name in (*THREADS, LONG_PLANS)}
        self._processes = [LongPlanner(arm, weights) for _ in range(arm.settings.planning.workers)]
        carriers = [*((name, None) for name in THREADS), *((LONG_PLANS, process) for process in self._processes)]
        self._threads = [
            threading.Thread(target=self._run, args=carrier, name=carrier[0], daemon=True) for carrier in carriers
        ]
        for thread in self._threads:
            thread.start()

    def start(self, number: int, task: Task) -> None:
        """Queues a task. It waits for earlier tasks of the same thread: abandon less urgent ones."""
        self._queued[number] = queued = QueuedTask(number, task)
        apart = self._processes and is_long(task)
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
        for thread in self._threads:
            self._queues[thread.name].put(None)
        until = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(until - time.monotonic(), 0.0))
        for process in self._processes:
            process.close()

    # --- the workers' threads

    def _run(self, name: str, process: LongPlanner | None) -> None:
        try:
            while (queued := self._queues[name].get()) is not None:
                last = self._answer(queued, process)
                self._queued.pop(queued.number, None)
                self._post(Answered(queued.number, last, True))
        except BaseException as error:  # also SystemExit, which would end a thread silently
            log.critical("the thread for %s has ended", name, exc_info=True)
            self._fatal(f"the planner's thread for {name} has ended: {error!r}")

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
                return computations.describe(self._for_queries, task, queued.proceed, lambda: self._hurry(queued))
            case tasks.FollowSetpoint():
                return computations.follow(self._for_setpoints, task)
            case tasks.CheckStages():
                return computations.check_stages(task, queued.proceed)
            case tasks.CheckStanding():
                return computations.check_standing(task)
            case tasks.BuildScene():
                return build_scene(self._arm, task)
            case tasks.BuildTables():
                return build_tables(self._arm, self._densities, self._weights, task)

    def _hurry(self, queued: QueuedTask) -> bool:
        """Returns whether a query must end early: it is abandoned, a goal is planned, or another query waits."""
        goal = any(isinstance(other.task, tasks.PlanGoal) for other in list(self._queued.values()))
        return queued.abandoned or goal or not self._queues["queries"].empty()
