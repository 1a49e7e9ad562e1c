"""The results of a study as a stream, in the order of its shares."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

from hyperbit.controller.studies.shares import Job, StudyFailed, alone, compute, pack

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 4  # shares in flight for each thread of a worker
COUNT_AGAIN = 1.0  # [s] until the threads of the workers are counted again
LOOK = 10.0  # [s] between two looks at the cluster while no result comes
SCHEDULER_TIMEOUT = 60.0  # [s] for the scheduler to answer


def results(job: Job, shares: Iterable[Any], client: Client | None = None) -> Generator[list[Any], None, None]:
    """Yields the results of each share, in order. Shares are read as they are needed.

    A share of a lost worker is computed again by another one.

    Args:
        job: what the shares have in common.
        shares: they can be pickled.
        client: of a Dask cluster that fits, see check_workers; None: this process computes all, and yields each result
            by itself.

    Raises:
        StudyFailed: the cluster is lost, or a worker has another version.
    """
    if client is None:
        yield from ([result] for result in alone(job, shares))
        return
    packed, waiting = pack(job), deque["Future"]()
    most, counted = 0, -math.inf
    try:
        for share in shares:
            waiting.append(client.submit(compute, packed, share, pure=False))
            if time.monotonic() > counted + COUNT_AGAIN:
                most, counted = AHEAD * max(1, sum(client.nthreads().values())), time.monotonic()
            while len(waiting) >= most:
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
            found: list[Any] = future.result(timeout=LOOK)
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
            if not threads_of(client):
                raise StudyFailed("the Dask cluster has no workers any more") from None


def threads_of(client: Client) -> dict[str, int]:
    """Returns the number of threads of each worker.

    Raises:
        StudyFailed: the scheduler does not answer in time.
    """
    try:
        found: dict[str, int] = client.sync(client.scheduler.ncores, callback_timeout=SCHEDULER_TIMEOUT)
    except (TimeoutError, OSError):
        raise StudyFailed(f"the Dask scheduler has not answered within {SCHEDULER_TIMEOUT:g} s") from None
    return found
