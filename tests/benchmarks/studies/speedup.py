"""Time of `hyperbit plan --goals --apart` with one process, with local workers, and on a Dask cluster.

Each row runs the command on the same goals and compares the results byte by byte. The rate is that of the last nine
tenths of the results: it leaves out imports, tables and the start of processes. One row runs a command for each worker
at once, each with its part of the goals: the processors of this computer allow about that. Rounds run all rows one
after the other; the table has the medians, and medians of the ratios of each round.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import NamedTuple

import hyperbit as hb
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures

PORT = 18787
HEADERS = ("workers", "whole command [s]", "first result [s]", "goals/s", "rate, times", "same bytes")


class Run(NamedTuple):
    """The output of the command, its time, and the times until its first result and until a tenth of them [s]."""

    output: bytes
    seconds: float
    first: float
    tenth: float


def main() -> None:
    given = CommandLine(__doc__, goals=10_000, effort=10.0, workers=2, rounds=1).parse()
    with tempfile.TemporaryDirectory() as folder:
        goals = Path(folder) / "goals.csv"
        arm = hb.load(PAPER_ARM)
        tips = arm.frames(arm.sample(given.goals, seed=1))[:, :2, 3].tolist()
        goals.write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in tips))
        options = "--apart", "--effort", str(given.effort), "--json"
        rounds = [ran(goals, options, given.workers) for _ in range(given.rounds)]
    rows = [medians(name, rounds, given.goals) for name in rounds[0]]
    show("", HEADERS, [[it if isinstance(it, str) else f"{it:.2f}" for it in row] for row in rows])
    write_figures(given.json, [dict(zip(HEADERS, row, strict=True)) for row in rows])


def ran(goals: Path, options: Sequence[str], workers: int) -> dict[str, Run]:
    words = "--goals", str(goals), *options
    runs = {"this process": plan(words)}
    with ThreadPoolExecutor(workers) as pool:
        parts = [["--goals", str(part), *options] for part in split(goals, workers)]
        each = list(pool.map(plan, parts))
    times = (max(run[k] for run in each) for k in (1, 2, 3))
    runs[f"{workers} commands, without workers"] = Run(b"".join(run.output for run in each), *times)
    runs[f"{workers} local"] = plan((*words, "--workers", str(workers)))
    with cluster(workers, goals.parent) as address:
        runs[f"{workers} of a cluster"] = plan((*words, "--dask", address))
    return runs


def medians(name: str, rounds: Sequence[dict[str, Run]], goals: int) -> tuple[str | float, ...]:
    """Returns the medians over the rounds; the rate is that of the last nine tenths."""
    runs, ones = [one[name] for one in rounds], [one["this process"] for one in rounds]
    took = [run.seconds - run.tenth for run in runs]
    return (
        name,
        median(run.seconds for run in runs),
        median(run.first for run in runs),
        median(0.9 * goals / each for each in took),
        median((one.seconds - one.tenth) / each for one, each in zip(ones, took, strict=True)),
        "yes" if all(run.output == one.output for one, run in zip(ones, runs, strict=True)) else "NO",
    )


def plan(words: Sequence[str]) -> Run:
    began, times, lines = time.perf_counter(), list[float](), list[bytes]()
    command = [sys.executable, "-m", "hyperbit", "plan", str(PAPER_ARM), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        for line in process.stdout:
            times.append(time.perf_counter() - began)
            lines.append(line)
    if process.returncode:
        sys.exit(process.returncode)
    return Run(b"".join(lines), time.perf_counter() - began, times[0], times[len(times) // 10])


def split(goals: Path, count: int) -> list[Path]:
    head, *rows = goals.read_text().splitlines(keepends=True)
    parts = [goals.with_name(f"part{k}.csv") for k in range(count)]
    for k, part in enumerate(parts):
        part.write_text(head + "".join(rows[k * len(rows) // count : (k + 1) * len(rows) // count]))
    return parts


@contextmanager
def cluster(count: int, folder: Path) -> Iterator[str]:
    """Starts a scheduler and workers of one thread each, as on several computers."""
    address = f"tcp://127.0.0.1:{PORT}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(PORT), "--no-dashboard"]
    worker = ["worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
    commands = [scheduler, *[worker] * count]
    processes = [
        subprocess.Popen([sys.executable, "-m", "dask", *words], stderr=subprocess.DEVNULL) for words in commands
    ]
    try:
        from distributed import Client

        with Client(address, timeout=60) as client:
            client.wait_for_workers(count, timeout=60)
        yield address
    finally:
        for process in processes[::-1]:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    main()
