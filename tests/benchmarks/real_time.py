"""The control loop's periods in real time and without, while the planner works and others burn the processors.

python -m tests.benchmarks.real_time [--seconds N] [--rounds N] [--json PATH]. Each daemon runs in a process of its own
with its boards and its client, which a robot's do not; the ways take turns, so that all meet the same neighbours.
"""

import argparse
import gc
import json
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from controller.config import load
from controller.daemon import session
from controller.daemon.client import Client
from controller.daemon.loop import PERIOD
from controller.daemon.service import Daemon, embedded, patient, running, simulated, timing_of, wiring_of
from controller.settings import RealTimeSettings
from controller.workspace.cache import default_directory, load_or_map
from tests.conftest import PAPER_ARM
from tests.soak.measuring import Periods

WAYS = {
    "ordinary": [],
    "nice -10": ["--nice", "-10"],
    "real time": ["--real-time"],
    "real time, nice -10": ["--real-time", "--nice", "-10"],
}
STEP, WAYPOINTS = 0.07, 100


def main() -> None:
    """Measures, prints, writes; with --one, one daemon in this process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--real-time", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--nice", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.seconds, options.real_time, options.nice)))
        return
    offs: dict[str, list[float]] = {way: [] for way in WAYS}
    told: dict[str, dict] = {way: {"planned": 0, "collections": 0, "longest collection": 0.0} for way in WAYS}
    with burning():
        for _ in range(options.rounds):
            for way, words in WAYS.items():
                command = [sys.executable, "-m", "tests.benchmarks.real_time", "--one", *words]
                ended = subprocess.run([*command, "--seconds", str(options.seconds)], capture_output=True, text=True)
                if ended.returncode != 0:
                    raise SystemExit(ended.stderr)
                one = json.loads(ended.stdout.splitlines()[-1])
                offs[way] += one["offs"]
                told[way]["real_time"] = one["real_time"]
                told[way]["planned"] += one["planned"]
                told[way]["collections"] += one["collections"]
                told[way]["longest collection"] = max(told[way]["longest collection"], one["longest collection"])
    report = {way: {**figures(np.array(off)), **told[way]} for way, off in offs.items()}
    names = ("median", "99 %", "99.9 %", "worst", "longest collection")
    table = Table("way", *names, "waypoints planned", title="|period - 10 ms| [ms], both processors burnt")
    for way, row in report.items():
        table.add_row(way, *(f"{1e3 * row[name]:.2f}" for name in names), str(row["planned"]))
    Console().print(table)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


def figures(off: np.ndarray) -> dict[str, float]:
    """Returns how far periods were from nominal [s]."""
    quantiles = {"median": 0.5, "99 %": 0.99, "99.9 %": 0.999, "worst": 1.0}
    return {"ticks": len(off), **{name: float(np.quantile(off, q)) for name, q in quantiles.items()}}


def burn() -> None:
    """Takes all the time a processor gives."""
    while True:
        pass


@contextmanager
def burning():
    """Has a process burn each processor while the context lasts."""
    burners = [multiprocessing.Process(target=burn, daemon=True) for _ in range(os.cpu_count() or 1)]
    for burner in burners:
        burner.start()
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.join()


class Collections:
    """Notes the number of garbage collections and the seconds that the longest took."""

    def __init__(self) -> None:
        self.number, self.longest, self._began = 0, 0.0, 0.0

    def __call__(self, phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            self._began = time.perf_counter()
        else:
            self.number += 1
            self.longest = max(self.longest, time.perf_counter() - self._began)


def measured(seconds: float, real_time: bool, nice: int) -> dict:
    """Runs one daemon for so long, planning all the time; returns how far each period was from nominal [s]."""
    os.nice(nice)
    sys.setswitchinterval(0.0005)  # as `hyperbit run` does
    arm = load(PAPER_ARM)
    densities = load_or_map(arm.manipulator, arm.pixel, arm.level_pixels, default_directory())
    if real_time:
        arm = replace(arm, settings=msgspec.structs.replace(arm.settings, real_time=RealTimeSettings()))
    wiring, timing = embedded(wiring_of(arm)), patient(timing_of(arm))
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    config = session.configuration("peer", listen=endpoint)
    with (
        tempfile.TemporaryDirectory() as folder,
        simulated(wiring, timing),
        running(Daemon(arm, densities, wiring, config, Path(folder) / "ledger.sqlite", timing)),
        zenoh.open(session.configuration("client", connect=endpoint)) as opened,
        Periods(int(200 * seconds)) as periods,
    ):
        client, heard = Client(opened, arm.settings.name), []
        states, words = client.subscribe("state", heard.append), []
        diagnostics = client.subscribe("diagnostics", words.append)
        while not heard or heard[-1]["mode"] != "ready" or not words:
            time.sleep(0.05)
        states.undeclare()
        collections = Collections()
        gc.callbacks.append(collections)
        periods.clear()
        began, planned = time.monotonic(), 0
        while time.monotonic() - began < seconds:
            answer = client.request("goal", {"waypoints": curve(planned), "tolerance": {"position": 0.01}}, timeout=60)
            if not answer["accepted"]:
                raise SystemExit(f"the goal was refused: {answer['message']}")
            planned += WAYPOINTS
            time.sleep(2.0)  # it looks ahead along the rest meanwhile, and then rests itself
            client.request("cancel")
            time.sleep(0.2)
        gc.callbacks.remove(collections)
        offs = np.abs(periods.seconds() - PERIOD).tolist()
        diagnostics.undeclare()
        collected = {"collections": collections.number, "longest collection": collections.longest}
        return {"offs": offs, "planned": planned, "real_time": words[-1]["real_time"], **collected}


def curve(turned: int) -> list[dict]:
    """Returns waypoints on an ellipse, from another point of it each time."""
    turns = turned + np.linspace(0, 2 * np.pi, WAYPOINTS)
    points = np.stack([0.2 + 0.4 * np.cos(turns), 2.5 + 0.25 * np.sin(turns)], axis=1).tolist()
    return [{"t": STEP * k, "position": point} for k, point in enumerate(points)]


if __name__ == "__main__":
    main()
