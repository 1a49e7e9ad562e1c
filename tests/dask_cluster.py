"""A Dask scheduler and its workers, each in a process of its own, as on several computers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from distributed import Client


class DaskCluster(NamedTuple):
    """The processes of a cluster, and the address of its scheduler."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def dask_cluster(workers: int, folder: Path) -> Iterator[DaskCluster]:
    """Starts a scheduler on a free port, and workers of one thread each; ends them."""
    file, processes = folder / "scheduler.json", list[subprocess.Popen[bytes]]()

    def start(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard", "--scheduler-file", str(file)]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        processes.append(process)
        return process

    try:
        scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0")
        own = "worker", "--nthreads", "1", "--no-nanny", "--local-directory", str(folder)
        started = [start(*own) for _ in range(workers)]
        with Client(scheduler_file=str(file), timeout=60) as client:
            client.wait_for_workers(workers, timeout=120)
            address = client.scheduler.address
        yield DaskCluster(address, scheduler, started)
    finally:
        for process in processes[::-1]:
            process.kill()
            process.wait()
