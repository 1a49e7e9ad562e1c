"""Solutions of many goals, by this process, by processes on this computer, or by a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import NDArray

from hyperbit.controller.library.arguments import Count, Number, typed
from hyperbit.controller.library.errors import StudyError
from hyperbit.controller.library.goals import GoalLike
from hyperbit.controller.library.solver import Solver, Start, checked_time
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.studies.shares import Run, StudyFailed, goals_a_share
from hyperbit.controller.studies.stream import results
from hyperbit.controller.studies.workers import check_workers, local_workers

if TYPE_CHECKING:
    from distributed import Client

EFFORT = 50.0  # about that of a search without a deadline


class SolverJob(NamedTuple):
    """What the shares of `map` have in common.

    Attributes:
        solver: it is pickled without its tables.
        start: configuration from which each search starts, shape (B,).
        method: search method.
        effort: work of each search.
    """

    solver: Solver
    start: Configuration
    method: Method
    effort: float

    def prepare(self) -> Run:
        """Returns what solves the goals of a share; the first of them builds the tables."""
        return self._run

    def _run(self, goals: Sequence[GoalLike]) -> Iterator[Solution]:
        for goal in goals:
            yield self.solver.solve(goal, self.start, method=self.method, effort=self.effort)


@typed(StudyError)
def map(
    solver: Solver,
    goals: Iterable[GoalLike] | NDArray[Any],
    start: Start = None,
    *,
    client: Client | None = None,
    workers: Count = 1,
    effort: Number = EFFORT,
    method: Method = MINIMUM_SWITCH,
) -> Iterator[Solution]:
    """Yields a solution for each goal, in the order of the goals, each searched from the same start.

    The searches end by work, so the solutions do not depend on the number of workers. Goals are read as they are
    needed. A script that starts workers needs `if __name__ == "__main__":`, as each worker process imports it.

    Args:
        solver: sent to the workers without its tables.
        goals: goals, or positions of shape (dimension,); any number.
        start: see Solver.solve.
        client: of a Dask cluster; None: `workers` compute.
        workers: number of processes on this computer; 1: this process.
        effort: see Solver.solve; of each goal.
        method: one of `METHODS`.

    Raises:
        GoalError: see Solver.solve; when the goal is reached.
        ConfigurationError: the start is no configuration of the arm.
        StudyError: Dask is not installed, or the cluster does not fit or is lost.
    """
    checked_time(method, None, effort)
    job = SolverJob(solver, solver.arm._to_whole(solver._start(start)), method, float(effort))
    return solutions(job, goals, client, workers)


def solutions(
    job: SolverJob, goals: Iterable[GoalLike] | NDArray[Any], client: Client | None, workers: int
) -> Iterator[Solution]:
    """Yields the solutions of a job; starts workers at the first."""
    left = iter(goals)
    shares = iter(lambda: list(islice(left, goals_a_share(job.effort))), [])
    try:
        if client is not None:
            check_workers(client)
        with nullcontext(client) if client is not None or workers == 1 else local_workers(workers) as used:
            for found in results(job, shares, used):
                yield from found
    except StudyFailed as error:
        raise StudyError(str(error)) from None
