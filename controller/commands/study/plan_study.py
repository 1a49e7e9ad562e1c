"""The goals of a file as a study: shares for this process, for local ones, or for a Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import errors
from hyperbit.controller.commands.sharing import Sharing, check_sharing, open_workers, progress_bar
from hyperbit.controller.commands.study.plan_goals import PlanOptions, PlanTask, WantedGoal, read_goals
from hyperbit.controller.commands.study.plan_results import MOST_ROWS, ShownResult, print_results, shown_result
from hyperbit.controller.commands.study.plan_search import follow, prepared_search, search_one, trajectories
from hyperbit.controller.commands.study.results_file import ResultsFile, open_results
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.studies.shares import Run, goals_a_share
from hyperbit.controller.studies.stream import results

if TYPE_CHECKING:
    from distributed import Client
    from rich.progress import Progress


class StudyOptions(NamedTuple):
    """The options of a study: who computes, and the file of the results."""

    sharing: Sharing
    output: Path | None


class PlanJob(NamedTuple):
    """What the shares of `plan --goals` have in common.

    Attributes:
        arm: the arm.
        options: of the command.
        start: configuration before the first goal, shape (B,).
        silent: show no progress of the tables.
    """

    arm: Arm
    options: PlanOptions
    start: Configuration
    silent: bool = True

    def prepare(self) -> Run:
        """Returns what searches the goals of a share: each apart, or all as one trajectory."""
        search = prepared_search(self.arm, self.options, silent=self.silent)

        def run(goals: list[WantedGoal]) -> Iterator[ShownResult]:
            apart = (search_one(search, goal, self.start) for goal in goals)
            for point in apart if self.options.apart else follow(search, goals, self.start):
                yield shown_result(self.arm, self.options, point)

        return run


def check_study(options: PlanOptions, where: StudyOptions) -> None:
    """Checks the options of a study.

    Raises:
        InputFaults: an option is for --goals only, or two options contradict each other.
    """
    given = where.sharing.given or (where.output and "--output")
    if given and options.goals is None:
        raise InputFaults(Path(given), ["it is for many goals: give --goals FILE.csv"])
    check_sharing(where.sharing)


def study_goals(job: PlanJob, task: PlanTask, where: StudyOptions, *, as_json: bool) -> None:
    """Searches the goals of a file; prints the results in order as they come, or writes them to a file.

    Raises:
        CommandFailed: the workers are missing, do not fit, or are lost.
    """
    with ExitStack() as stack:
        file = None if where.output is None else stack.enter_context(results_of(job, task, where.output))
        done = 0 if file is None else file.done
        if done:
            errors.print(f"{where.output} has {done} of {task.total} goals; the search goes on after them")
        counter = [done]
        client = stack.enter_context(open_workers(where.sharing, lambda: remedy(counter[0], task.total, where)))
        found = stack.enter_context(closing(stream(job, client, done)))
        progress = stack.enter_context(progress_bar("goals", shown=file is not None or not as_json))
        counted = count(found, counter, progress, task.total)
        if file is not None:
            for result in counted:
                file.write(result.line)
            errors.print(f"{where.output} has the results of {task.total} goals")
        else:
            print_results(counted, job.options, as_json=as_json, many=task.total > MOST_ROWS)


def stream(job: PlanJob, client: Client | None, done: int) -> Generator[ShownResult, None, None]:
    """Yields the results of all goals but the first `done`, in order."""
    for found in results(job, shares(job, done), client):
        yield from found


def shares(job: PlanJob, done: int) -> Iterator[list[WantedGoal]]:
    """Yields the goals of each share as they are read: some goals apart, or one trajectory."""
    goals = islice(read_goals(job.arm, job.options.goals or Path()), done, None)
    if not job.options.apart:
        yield from trajectories(goals)
        return
    while share := list(islice(goals, goals_a_share(job.options.effort))):
        yield share


def results_of(job: PlanJob, task: PlanTask, path: Path) -> ResultsFile:
    """Opens the file of results, which belongs to one arm, file of goals and set of options."""
    own = {name: value for name, value in job.options._asdict().items() if name != "goals" and value is not None}
    header = {"study": "plan", "arm": job.arm.digest, "goals": task.digest, "options": own}
    return open_results(path, header, ends(job))


def ends(job: PlanJob) -> Iterator[int]:
    """Yields the number of goals up to the end of each part that is searched as a whole."""
    goals, total = read_goals(job.arm, job.options.goals or Path()), 0
    for part in ([goal] for goal in goals) if job.options.apart else trajectories(goals):
        total += len(part)
        yield total


def count(found: Iterable[ShownResult], counter: list[int], progress: Progress, total: int) -> Iterator[ShownResult]:
    """Yields the results; counts the goals among them in `counter` and on the progress bar."""
    task = progress.add_task("", total=total, completed=counter[0], before=counter[0])
    for result in found:
        yield result
        counter[0] += not result.line.get("between", False)
        progress.update(task, completed=counter[0])


def remedy(done: int, total: int, where: StudyOptions) -> str:
    """Returns how many goals are done, and how to get the others; "" if none is."""
    if done == 0:
        return ""
    if where.output is None:
        return f"{done} of {total} goals are done; with --output FILE.jsonl the same command goes on where it ended"
    return f"{where.output} has {done} of {total} goals; the same command goes on after them"
