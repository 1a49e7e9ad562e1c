"""Processor time and wake-ups of executor and planner while the arm rests, and memory of both.

python -m tests.benchmarks.daemon.rest [--seconds N] [--json PATH]

Sixteen boards in another process send their heartbeats at different times, as the crystals of real boards drift.
The bus of "polled" has no file descriptor. A wake-up is a voluntary context switch of a thread.
"""

import time
from pathlib import Path

from tests.benchmarks.daemon.chain import Chain
from tests.benchmarks.harness import CommandLine, report

SETTLES = 5.0  # [s] until everything has started
MOST_SHARE, MOST_WAKES, MOST_WAKES_POLLED = 6.0, 50.0, 60.0  # bars of the executor: [%] of a processor; a second
MOST_MEMORY = 250.0  # [MB] of the planner, a bar
NANO = 1e-9


def looked_at(pid: int) -> tuple[float, int]:
    """Returns the processor time of a process so far [s], and the number of its wake-ups."""
    ran, woken = 0.0, 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        ran += NANO * int((task / "schedstat").read_text().split()[0])
        fields = dict(line.split(":\t") for line in (task / "status").read_text().splitlines() if ":\t" in line)
        woken += int(fields["voluntary_ctxt_switches"])
    return ran, woken


def memory(pid: int) -> float:
    """Returns the resident memory of a process [MB]."""
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return round(int(line.split()[1]) / 1024, 1)


def resting(seconds: float, polled: bool) -> dict[str, dict[str, float]]:
    figures = {}
    with Chain(spread=True, polled=polled) as chain:
        time.sleep(SETTLES)
        pids = {"planner": chain.processes["planner"].pid, "executor": chain.processes[chain.executor].pid}
        began, before = time.monotonic(), {name: looked_at(pid) for name, pid in pids.items()}
        time.sleep(seconds)
        passed, after = time.monotonic() - began, {name: looked_at(pid) for name, pid in pids.items()}
        for name, pid in pids.items():
            ran, woken = (b - a for a, b in zip(before[name], after[name], strict=True))
            share, wakes = round(100 * ran / passed, 2), round(woken / passed, 1)
            figures[name] = {"percent of a processor": share, "wake-ups a second": wakes, "MB": memory(pid)}
    beats = chain.records["beats"]["at"]
    beats = beats[(beats > began) & (beats < began + passed)]
    figures["heartbeat"] = {"mean period [ms]": round(1e3 * float(beats[-1] - beats[0]) / (len(beats) - 1), 2)}
    return figures


def main() -> None:
    options = CommandLine(__doc__, seconds=20.0).parse()
    figures = {"on a bus": resting(options.seconds, False), "polled": resting(options.seconds, True)}
    on, polled = figures["on a bus"]["executor"], figures["polled"]["executor"]
    bars = {
        f"at most {MOST_SHARE:g} % of a processor": on["percent of a processor"] <= MOST_SHARE,
        f"at most {MOST_WAKES:g} wake-ups a second": on["wake-ups a second"] <= MOST_WAKES,
        f"planner: at most {MOST_MEMORY:g} MB": figures["on a bus"]["planner"]["MB"] <= MOST_MEMORY,
        f"at most {MOST_WAKES_POLLED:g} without a descriptor": polled["wake-ups a second"] <= MOST_WAKES_POLLED,
    }
    report(figures, bars, options.json)


if __name__ == "__main__":
    main()
