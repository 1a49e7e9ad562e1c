"""Long plans on a Dask cluster: connected in the background, so that no plan waits for a scheduler that is away."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.plans.point_by_point import PLANNING_TIME
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.tasks import Answer, Failed
from hyperbit.controller.planning.workers.arm_model import Abandoned
from hyperbit.controller.planning.workers.long_plans import LongAnswer, LongPlan, Planner
from hyperbit.controller.studies.shares import PackedJob, Run, StudyFailed, compute, pack
from hyperbit.controller.studies.stream import result_of
from hyperbit.controller.studies.workers import cluster_workers

if TYPE_CHECKING:
    from distributed import Client

RETRY = 5.0  # [s] between two connections
PREPARE = 600.0  # [s] for the workers to build their tables
GRACE = 2.0  # [s] after a plan's deadline for its answer to arrive
LOOK = 0.2  # [s] between two looks at the cluster while a plan is computed
PRIORITY = 100  # before the shares of studies, which have 0


class PlanningJob(NamedTuple):
    """What the long plans of a daemon have in common; for `arm` and `weights` see `build_tables`."""

    arm: Arm
    weights: NDArray[np.float64]

    def prepare(self) -> Run:
        """Builds the tables; returns what answers a plan. None in place of a plan only builds the tables."""
        planner = Planner(self.arm, self.weights)
        planner.prepare(self.arm.locked.astype(np.uint8).tobytes())

        def run(plan: LongPlan | None) -> Iterator[Answer]:
            yield tasks.Done() if plan is None else planner.answer(plan, proceed_on_cluster())

        return run


def proceed_on_cluster() -> Callable[[], bool]:
    """Returns the `proceed` of the present task of a worker: Dask cannot end a running task, so it ends itself."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def proceed() -> bool:
        """Raises Abandoned if nobody waits for the task any more."""
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise Abandoned
        return False

    return proceed


class ClusterPlanner:
    """Sends long plans to a cluster. A thread of its own connects, and has the workers build their tables.

    Args:
        address: of the scheduler.
        arm, weights: as in `build_tables`.
        home: computes the plans that the cluster does not answer.
    """

    def __init__(self, address: str, arm: Arm, weights: NDArray[np.float64], home: Planner) -> None:
        self._address, self._job, self._home = address, pack(PlanningJob(arm, weights)), home
        self._client: Client | None = None
        self._why = f"{address}: the workers are not ready yet"
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._stay_connected, name="dask", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the connection, at the latest when a connection attempt is over."""
        self._closed.set()
        self._thread.join()

    def wait(self, seconds: float) -> bool:
        """Waits until the cluster is ready, or a time [s] is over; returns whether it is ready."""
        with self._changed:
            return self._changed.wait_for(lambda: self._client is not None, seconds)

    def answer_long(self, plan: LongPlan) -> LongAnswer:
        """Returns the answer of the cluster; else that of this process in the time left, with a warning."""
        began = time.monotonic()
        try:
            return LongAnswer(self.answer(plan))
        except StudyFailed as error:
            here = left_after(plan, time.monotonic() - began)
            return LongAnswer(self._home.answer(here), f"{error}; the plan is computed on this computer instead")

    def answer(self, plan: LongPlan) -> Answer:
        """Returns the answer of the cluster.

        Raises:
            StudyFailed: there is none; the message tells why.
        """
        if (client := self._client) is None:
            raise StudyFailed(self._why)
        seconds = (plan.message.deadline or plan.seconds) + GRACE
        try:
            future = client.submit(compute, self._job, plan, pure=False, priority=PRIORITY)
            [found] = result_of(future, client, seconds, LOOK)
        except StudyFailed:
            raise
        except Exception as error:  # what another code raises there
            raise StudyFailed(f"{self._address}: {type(error).__name__}: {error}") from None
        if isinstance(found, Failed):
            raise StudyFailed(f"{self._address}: {found.reason.strip().splitlines()[-1]}")
        answer: Answer = found
        return answer

    def _stay_connected(self) -> None:
        while not self._closed.is_set():
            try:
                with cluster_workers(self._address) as client:
                    prepare_workers(client, self._job)
                    self._set(client, "")
                    while client.status == "running" and not self._closed.wait(LOOK):
                        pass
                    self._set(None, "")
                why = f"{self._address}: the connection to the Dask scheduler is lost"
            except StudyFailed as error:
                why = str(error)
            except Exception as error:  # Dask's own
                why = f"{self._address}: {type(error).__name__}: {error}"
            self._set(None, why)
            self._closed.wait(RETRY)

    def _set(self, client: Client | None, why: str) -> None:
        with self._changed:
            self._client, self._why = client, why
            self._changed.notify_all()


def prepare_workers(client: Client, job: PackedJob) -> None:
    """Has each worker build its tables.

    Raises:
        StudyFailed: a worker fails, or is lost.
    """
    until = time.monotonic() + PREPARE
    futures = [client.submit(compute, job, None, pure=False, workers=[worker]) for worker in client.nthreads()]
    for future in futures:
        result_of(future, client, max(until - time.monotonic(), 0.0))


def left_after(plan: LongPlan, spent: float) -> LongPlan:
    """Returns a plan with the time that is left after some time [s] was spent in vain."""
    deadline = max((plan.message.deadline or plan.seconds) - spent, PLANNING_TIME)
    return plan._replace(message=msgspec.structs.replace(plan.message, deadline=deadline))
