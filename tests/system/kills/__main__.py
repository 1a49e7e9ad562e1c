"""Kills each process many times at each moment, and prints a table: python -m tests.system.kills --each 20

Ends with 1 if a result was doubled or missing, or anything else was wrong. Several moments run at once, each on an arm
of its own.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from tests.system.kills.campaign import Campaign, KillNursery, Tally
from tests.system.kills.moments import MOMENTS, PROCESSES
from tests.system.stack import arms
from tests.system.stack.processes import ROOT, Nursery
from tests.system.stack.system import System

COLUMNS = ("kills", "goals", "results", "unanswered", "doubled", "missing", "lost", "repeated", "again")
EACH_SYSTEM = 60  # kills of one arm, because the ledger is read as its latest thousand goals


def run(moment: str, victims: list[str], each: int, first: int) -> dict[str, Tally]:
    """Kills at one moment in this process; returns the tallies by process."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache" / "hyperbit"
        file = arms.write(Path(folder), "planar", "none", {"interface": "virtual", "channel": "none"}, {})
        environment = {"XDG_CACHE_HOME": str(cache.parent)}
        nurseries = {"executor": Nursery("executor", environment), "planner": KillNursery("planner", environment, file)}
        campaign = Campaign(lambda: System("emulated", "planar", {"boards": arms.QUICK}, nurseries, cache))
        try:
            for k, (number, victim) in enumerate(itertools.product(range(first, first + each), victims), 1):
                campaign.kill(moment, victim, number)
                if k % EACH_SYSTEM == 0:
                    campaign.close()
                print(f"{moment} {victim} {number}: {asdict(campaign.tallies[moment, victim])}", file=sys.stderr)
            campaign.close()
        finally:
            for nursery in nurseries.values():
                nursery.close()
    return {victim: tally for (_, victim), tally in campaign.tallies.items()}


def run_process(moment: str, arguments: argparse.Namespace) -> dict[str, dict[str, object]]:
    command = [sys.executable, "-m", "tests.system.kills", "--one", moment, "--each", str(arguments.each)]
    command += ["--first", str(arguments.first), "--process", *arguments.process]
    arguments.logs.mkdir(parents=True, exist_ok=True)
    with (arguments.logs / f"{moment}.log").open("w") as log:
        ended = subprocess.run(command, stdout=subprocess.PIPE, stderr=log, text=True, cwd=ROOT)
    try:
        return dict(json.loads(ended.stdout.splitlines()[-1]))
    except (IndexError, ValueError):
        return {"all": {**asdict(Tally()), "wrong": [f"{moment}: the process ended with {ended.returncode}"]}}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=20, help="kills of each process at each moment")
    parser.add_argument("--first", type=int, default=0, help="seed of the first kill")
    parser.add_argument("--moment", nargs="*", default=list(MOMENTS), choices=list(MOMENTS))
    parser.add_argument("--process", nargs="*", default=list(PROCESSES), choices=PROCESSES)
    parser.add_argument("--jobs", type=int, default=3, help="moments at once")
    parser.add_argument("--logs", type=Path, default=Path(tempfile.gettempdir()), help="folder of the logs")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        tallies = run(arguments.one, arguments.process, arguments.each, arguments.first)
        print(json.dumps({victim: asdict(tally) for victim, tally in tallies.items()}), flush=True)
        os._exit(0)  # threads of simulated boards may be left
    print(f"{'moment':<14}{'process':<10}" + "".join(f"{name:>11}" for name in COLUMNS), flush=True)
    wrong: list[str] = []
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for moment, rows in zip(
            arguments.moment, pool.map(lambda moment: run_process(moment, arguments), arguments.moment), strict=True
        ):
            for process, row in rows.items():
                print(f"{moment:<14}{process:<10}" + "".join(f"{row[name]:>11}" for name in COLUMNS), flush=True)
                wrong += map(str, row["wrong"])  # type: ignore[call-overload]
    print(*wrong, sep="\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
