"""The options --workers and --dask of commands that share work: their check, the workers, progress, and the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, nullcontext
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import CommandFailed, errors
from hyperbit.controller.studies.shares import Job, Spread, StudyFailed
from hyperbit.controller.studies.stream import results
from hyperbit.controller.studies.workers import cluster_workers, local_workers

if TYPE_CHECKING:
    from distributed import Client
    from rich.progress import Progress


class Sharing(NamedTuple):
    """Who computes: `workers` processes on this computer, 1: this process; or the cluster of the scheduler `dask`."""

    workers: int
    dask: str | None

    @property
    def given(self) -> str | None:
        """The option that asks for other processes; None: this process computes."""
        return "--dask" if self.dask is not None else "--workers" if self.workers > 1 else None


def checked_sharing(workers: int, dask: str | None) -> Sharing:
    if dask is not None and workers > 1:
        raise InputFaults(Path("--dask"), ["the cluster has its own workers: leave out --workers"])
    return Sharing(workers, dask)


@contextmanager
def open_workers(sharing: Sharing, remedy: Callable[[], str] = lambda: "") -> Iterator[Client | None]:
    """Opens the workers of a command: a client of Dask, or None for this process.

    `remedy` returns what is done so far, and how to get the rest, after Ctrl-C and lost workers.
    """
    try:
        if sharing.dask is not None:
            opened: Any = cluster_workers(sharing.dask)
        else:
            opened = nullcontext() if sharing.workers == 1 else local_workers(sharing.workers)
        with opened as client:
            yield client
    except StudyFailed as error:
        raise CommandFailed(str(error), remedy()) from None
    except KeyboardInterrupt:
        errors.print(f"interrupted: {remedy() or 'no result is kept'}")
        raise typer.Exit(130) from None


@contextmanager
def progress_bar(unit: str, *, shown: bool = True) -> Iterator[Progress]:
    """Shows counts, rate and time left on stderr, if that is a terminal and no results are printed there as well."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        """Units in a second, and the time left. Shares come many at once, so both are means since the start."""

        def render(self, task: Task) -> Text:
            rate = (task.completed - task.fields.get("before", 0)) / (task.elapsed or math.inf)
            left = f"{timedelta(seconds=round(task.remaining / rate))} left" if rate and task.remaining else ""
            return Text(f"{rate:.3g} {unit}/s  {left}")

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate()
    with Progress(*columns, console=errors, transient=True, disable=not (shown and errors.is_terminal)) as progress:
        yield progress


def spread_over(client: Client | None, progress: Progress, name: str, each: Callable[[Any], int] = len) -> Spread:
    """Returns what computes the shares of a job on the workers, and shows how far it is.

    `each` returns the number of results of a share.
    """

    def spread(job: Job, shares: Iterable[Any]) -> Iterator[Any]:
        every = list(shares)
        task = progress.add_task(name, total=sum(map(each, every)))
        with closing(results(job, every, client)) as stream:
            for found in stream:
                yield from found
                progress.advance(task, len(found))
        progress.remove_task(task)

    return spread
