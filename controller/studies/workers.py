"""The workers of a study: processes on this computer, or a Dask cluster; both by Dask's Client.

Dask starts the processes, finds a lost worker, and gives its shares to others. concurrent.futures has no remedy for a
lost process: it breaks the whole pool.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING, Any

from hyperbit.controller.studies.shares import StudyFailed, wrong_version

if TYPE_CHECKING:
    from distributed import Client

CONNECT = 10.0  # [s] for the connection to a scheduler
NEEDED = ("hyperbit", "numba")  # packages of a worker
# This process ends the study, and its workers. Stdout is for the results.
PRELOAD = (
    "import sys\nfrom hyperbit.controller.host import signals\n"
    "signals.ignore(signals.OF_TERMINAL)\nsys.stdout = sys.stderr\n"
)
# What Dask records of itself takes a tenth of a processor from the workers, and keeps the last 1000 messages in memory.
UNWATCHED = {
    "distributed.admin.low-level-log-length": 10,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.profile.enabled": False,
}
INSTALL = "Dask is not installed: pip install 'hyperbit[dask]'"


@contextmanager
def local_workers(count: int) -> Iterator[Client]:
    """Starts processes on this computer, with a thread each.

    Raises:
        StudyFailed: Dask is not installed, or the processes cannot be started.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise StudyFailed(INSTALL) from None
    with quiet(), dask.config.set(UNWATCHED):
        try:
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                preload=[PRELOAD],
            )
        except (OSError, RuntimeError) as error:
            raise StudyFailed(f"{count} worker processes cannot be started: {error}") from None
        with cluster, Client(cluster) as client:
            yield client


@contextmanager
def cluster_workers(address: str) -> Iterator[Client]:
    """Connects to the scheduler of a Dask cluster, such as tcp://host:8786, and checks its workers.

    Raises:
        StudyFailed: Dask is not installed, there is no scheduler, or the cluster does not fit.
    """
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise StudyFailed(INSTALL) from None
    with quiet():
        try:
            with dask.config.set(UNWATCHED):
                client = Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise StudyFailed(
                f"{address}: no Dask scheduler answers ({reason}); start one with `dask scheduler`"
            ) from None
        with client:
            check_workers(client)
            yield client


def check_workers(client: Client) -> None:
    """Checks that scheduler and workers have what a study needs.

    Raises:
        StudyFailed: there are no workers, or versions differ.
    """
    where = client.scheduler.address
    here, theirs = (client.get_versions()[side]["packages"]["distributed"] for side in ("client", "scheduler"))
    if here != theirs:
        raise StudyFailed(f"the scheduler {where} runs Dask {theirs}, and this computer {here}: install the same there")
    if not client.nthreads():
        raise StudyFailed(f"the scheduler {where} has no workers: start one with `dask worker {where}`")
    for package in NEEDED:
        needed = metadata.version(package)
        found: dict[str, Any] = client.run(metadata.version, package, on_error="return")
        for worker, version in found.items():
            if not isinstance(version, str):
                own = metadata.version("hyperbit")
                raise StudyFailed(f"worker {worker} has no {package}, here is {needed}: install hyperbit {own} there")
            if package == "hyperbit" and version != needed:
                raise StudyFailed(wrong_version(f"worker {worker}", version, needed))


@contextmanager
def quiet() -> Iterator[None]:
    """Silences Dask's warnings and logs: hyperbit says what is wrong in its own words. Dask must be imported."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
