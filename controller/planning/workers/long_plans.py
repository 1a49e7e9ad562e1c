"""Plans that may take seconds, each in its own process: they occupy neither the planner's threads nor the GIL."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Callable
from importlib.metadata import version
from multiprocessing.connection import Connection, wait

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.signals import OF_TERMINAL, ignore
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.tasks import Answer, DescribePlan
from hyperbit.controller.planning.workers.computations import ArmModel, build_scene, build_tables, describe
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.densities import Densities

log = logging.getLogger(__name__)

LONG = 1.0  # [s]: a plan with a later deadline is long
POLL = 0.05  # [s] between two tests whether a plan is still wanted
START = 60.0  # [s] for a process to start and to send its answer, on a busy machine
NICE = 10  # goals and set-points have priority, if the service permits a lower priority
SPAWN = multiprocessing.get_context("spawn")  # a fork would copy the locks of threads


def is_long(task: tasks.Task) -> bool:
    return isinstance(task, DescribePlan) and (task.goal.message.deadline or 0.0) > LONG


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
        self._process.kill()
        self._process.join()

    def _restart(self) -> None:
        self.close()
        self._start()

    def _start(self) -> None:
        """Starts the process, which needs seconds; plans wait for it."""
        self._connection, theirs = SPAWN.Pipe()
        self._process = SPAWN.Process(target=serve, args=(theirs, *self._arguments), name="long plans", daemon=True)
        self._process.start()
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
    planner = Planner(arm, weights)
    planner.prepare(arm.locked.astype(np.uint8).tobytes())
    answer_plans(connection, planner, expected)


def answer_plans(connection: Connection, planner: Planner, expected: str) -> None:
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
    """Ends this process, also within a search, when its parent ends."""
    if (parent := multiprocessing.parent_process()) is not None:
        wait([parent.sentinel])
        os._exit(1)


class Planner:
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
            return describe(self._model, task, lambda: False, lambda: False)
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
