"""The results of a study as a stream, in the order of its shares."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

from controller.studies.shares import Job, StudyFailed, compute, pack
from controller.studies.workers import check_workers

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 4  # shares in flight for each thread of a worker
PATIENCE = 10.0  # [s] between two looks at the cluster while no result comes


def results(job: Job, shares: Iterable[Any], client: Client | None = None) -> Iterator[list[Any]]:
    """Yields the results of each share, in order. Shares are read as they are needed.

    A share of a lost worker is computed again by another one.

    Args:
        job: what the shares have in common.
        shares: they can be pickled.
        client: of a Dask cluster; None: this process computes all, and yields each result by itself.

    Raises:
        StudyFailed: the cluster does not fit, or is lost.
    """
    if client is None:
        run = job.prepare()
        for share in shares:
            for result in run(share):
                yield [result]
        return
    check_workers(client)
    packed, waiting = pack(job), deque["Future"]()
    try:
        for share in shares:
            waiting.append(client.submit(compute, packed, share, pure=False))
            while len(waiting) >= AHEAD * max(1, sum(client.nthreads().values())):
                yield result_of(waiting[0], client)
                waiting.popleft()
        while waiting:
            yield result_of(waiting[0], client)
            waiting.popleft()
    finally:
        if waiting and client.status == "running":
            client.cancel(list(waiting), force=True)


def result_of(future: Future, client: Client) -> list[Any]:
    """Waits for the result of a share.

    Raises:
        StudyFailed: the share ends its workers, or no worker or no scheduler is left.
    """
    from distributed import KilledWorker

    while True:
        try:
            found: list[Any] = future.result(timeout=PATIENCE)
            return found
        except KilledWorker as error:
            lost, last = error.allowed_failures + 1, error.last_worker.address
            raise StudyFailed(f"{lost} workers were lost with the same share, the last {last}; read its log") from None
        except ModuleNotFoundError as error:
            raise StudyFailed(f"a worker has no {error.name}: install hyperbit there") from None
        except CancelledError as error:
            raise StudyFailed("the Dask cluster has dropped the study: its scheduler has ended") from error
        except TimeoutError:
            if client.status != "running":
                raise StudyFailed("the connection to the Dask scheduler is lost") from None
            if not client.nthreads():
                raise StudyFailed("the Dask cluster has no workers any more") from None
