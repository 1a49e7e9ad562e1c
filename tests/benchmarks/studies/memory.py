"""Peak memory of `hyperbit plan --goals --apart` over the number of goals, with one process and with local workers.

The goals are cheap: the arm reaches each of them where it is. So the number of goals is what the memory could grow
with.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

import hyperbit as hb
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures

HEADERS = ("goals", "workers", "command [MB]", "a worker [MB]", "results", "time [s]")
LOOK = 0.2  # [s] between two looks at the processes


def main() -> None:
    line = CommandLine(__doc__)
    line.add_argument("--counts", default="10000,100000,1000000", help="numbers of goals (default: %(default)s)")
    line.add_argument("--workers", type=int, default=2, help="number of worker processes (default: 2)")
    given = line.parse()
    rows = list[tuple[float, ...]]()
    with tempfile.TemporaryDirectory() as folder:
        for goals in map(int, given.counts.split(",")):
            for workers in (1, given.workers):
                rows.append((goals, workers, *measured(goals, workers, Path(folder))))
    show("", HEADERS, [[f"{it:,.0f}" for it in row] for row in rows])
    write_figures(given.json, [dict(zip(HEADERS, row, strict=True)) for row in rows])


def measured(goals: int, workers: int, folder: Path) -> tuple[float, float, int, float]:
    """Returns most memory of the command and of a worker [MB], number of results, and time [s]."""
    arm = hb.load(PAPER_ARM)
    x, y = arm.position(arm.sample(1, seed=1)[0] * 0).tolist()
    file, output = folder / "goals.csv", folder / "results.jsonl"
    with file.open("w") as rows:
        rows.write("x,y\n")
        rows.writelines(f"{x + 1e-9 * (k % 1000):.9f},{y:.9f}\n" for k in range(goals))
    output.unlink(missing_ok=True)
    words = "--goals", str(file), "--apart", "--effort", "1", "--output", str(output), "--workers", str(workers)
    began, command, worker = time.perf_counter(), 0.0, 0.0
    with subprocess.Popen(
        [sys.executable, "-m", "hyperbit", "plan", str(PAPER_ARM), *words], stderr=subprocess.DEVNULL
    ) as process:
        own = psutil.Process(process.pid)
        while process.poll() is None:
            command = max(command, peak(own))
            worker = max([worker, *map(peak, children(own))])
            time.sleep(LOOK)
    if process.returncode:
        sys.exit(process.returncode)
    with output.open() as results:
        lines = sum(1 for _ in results) - 1  # without the first line, which says what they belong to
    return command, worker, lines, time.perf_counter() - began


def children(process: psutil.Process) -> list[psutil.Process]:
    try:
        found: list[psutil.Process] = process.children(recursive=True)
        return found
    except psutil.Error:
        return []


def peak(process: psutil.Process) -> float:
    """Returns the most memory that a process has had [MB]; 0: it has ended."""
    try:
        status = Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return 0.0
    found = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return int(found[0]) / 1000 if found else 0.0


if __name__ == "__main__":
    main()
