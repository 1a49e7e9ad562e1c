"""The daemon's own times: goal put to SYNC on the bus, and the control loop's periods while it plans.

python -m tests.benchmarks.daemon [--goals N] [--json PATH]. Daemon, simulated boards, client and listener share one
process and its interpreter lock here, which a robot's do not.
"""

import argparse
import json
import queue
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path

import can
import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from controller.config import load
from controller.daemon import session
from controller.daemon.client import Client
from controller.daemon.loop import PERIOD
from controller.daemon.service import Daemon, embedded, patient, running, simulated, timing_of, wiring_of
from controller.daemon.timekeeping import Timekeeper
from controller.search.solver import Solver
from controller.workspace.mapping import map_densities

ARM = Path(__file__).parents[2] / "deploy" / "planar16.yaml"
SYNC = 0x080
CURVE = 300


class Times:
    """What is measured beside the daemon: periods of its loop, seconds of its searches."""

    def __init__(self) -> None:
        """Listens to every Timekeeper and Solver from now on."""
        self.periods: list[float] = []
        self.solves: list[float] = []
        ticked, solve = Timekeeper.ticked, Solver.solve

        def noting_ticked(keeper, began, ended):
            self.periods.append(began - keeper._last)
            ticked(keeper, began, ended)

        def noting_solve(solver, *args, **options):
            began = time.perf_counter()
            found = solve(solver, *args, **options)
            self.solves.append(time.perf_counter() - began)
            return found

        Timekeeper.ticked, Solver.solve = noting_ticked, noting_solve


def latencies(client: Client, bus: can.BusABC, goals: np.ndarray, times: Times) -> tuple[list[float], list[float]]:
    """Returns seconds from a goal's put to its SYNC, and those of its search within them."""
    results: queue.SimpleQueue[dict] = queue.SimpleQueue()
    subscriber = client.subscribe("result", results.put)
    syncs: queue.SimpleQueue[float] = queue.SimpleQueue()
    closing = threading.Event()

    def listen() -> None:
        while not closing.is_set():
            message = bus.recv(0.1)
            if message is not None and message.arbitration_id == SYNC:
                syncs.put(time.perf_counter())

    listener = threading.Thread(target=listen)
    listener.start()
    whole, searching = [], []
    for k, goal in enumerate(goals):
        payload = json.dumps({"id": f"g{k}", "waypoints": [{"position": goal.tolist()}]})
        before = len(times.solves)
        began = time.perf_counter()
        client._session.put(f"hyperbit/{client._arm}/goal", payload)
        whole.append(syncs.get(timeout=10) - began)
        searching.append(sum(times.solves[before:]))
        results.get(timeout=10)
        while not syncs.empty():
            syncs.get()
    closing.set()
    listener.join()
    subscriber.undeclare()
    return whole, searching


def curve(count: int) -> list[dict]:
    """Returns waypoints of a closed curve, as fast as the actuators can."""
    turns = np.linspace(0.0, 2 * np.pi, count)
    return [{"t": 0.07 * k, "position": [0.2 + 0.4 * np.cos(a), 2.5 + 0.25 * np.sin(a)]} for k, a in enumerate(turns)]


def main() -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=200)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    sys.setswitchinterval(0.0005)  # as `hyperbit run` does
    arm = load(ARM)
    densities = map_densities(arm.manipulator, arm.pixel, arm.level_pixels)
    states = np.random.default_rng(7).integers(0, 8, (options.goals, 16))
    goals = arm.manipulator.tips(states)[:, :2, 3]
    wiring, timing = embedded(wiring_of(arm)), patient(timing_of(arm))
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    times = Times()
    config = session.configuration("peer", listen=endpoint)
    with (
        tempfile.TemporaryDirectory() as folder,
        can.Bus(interface="virtual", channel=wiring.buses[0].channel) as bus,
        simulated(wiring, timing),
        running(Daemon(arm, densities, wiring, config, Path(folder) / "ledger.sqlite", timing)),
        zenoh.open(session.configuration("client", connect=endpoint)) as opened,
    ):
        client = Client(opened, arm.settings.name)
        modes: queue.SimpleQueue[str] = queue.SimpleQueue()
        subscriber = client.subscribe("state", lambda state: modes.put(state["mode"]))
        while modes.get(timeout=60) != "ready":
            pass
        subscriber.undeclare()
        idle = measured_idle(times)
        whole, searching = latencies(client, bus, goals, times)
        times.periods.clear()
        result = client.run({"waypoints": curve(CURVE)})
        planning = list(times.periods)
    report = {
        "latency_median": float(np.median(whole)),
        "latency_99": float(np.quantile(whole, 0.99)),
        "search_median": float(np.median(searching)),
        "search_99": float(np.quantile(searching, 0.99)),
        "periods_idle_within_20_percent": within(idle),
        "periods_planning_within_20_percent": within(planning),
        "period_planning_99": float(np.quantile(planning, 0.99)),
        "curve_waypoints": CURVE,
        "curve_switches": result["switches"],
    }
    table = Table(
        "figure", "value", title=f"{len(goals)} goals, then a curve of {CURVE} waypoints planned while it runs"
    )
    table.add_row("goal put to SYNC, median", f"{1e3 * report['latency_median']:.2f} ms")
    table.add_row("goal put to SYNC, 99 %", f"{1e3 * report['latency_99']:.2f} ms")
    table.add_row("the search's share, median", f"{1e3 * report['search_median']:.2f} ms")
    table.add_row("the search's share, 99 %", f"{1e3 * report['search_99']:.2f} ms")
    table.add_row("loop periods within 20 % of 10 ms, idle", f"{report['periods_idle_within_20_percent']:.2%}")
    table.add_row("loop periods within 20 % of 10 ms, planning", f"{report['periods_planning_within_20_percent']:.2%}")
    table.add_row("loop period while planning, 99 %", f"{1e3 * report['period_planning_99']:.2f} ms")
    table.add_row("switches along the curve", str(report["curve_switches"]))
    Console().print(table)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


def measured_idle(times: Times, count: int = 300) -> list[float]:
    """Returns the periods of `count` ticks of the loop while it has nothing to do."""
    times.periods.clear()
    while len(times.periods) < count:
        time.sleep(0.05)
    return list(times.periods)


def within(periods: list[float]) -> float:
    """Returns the share of periods within 20 % of nominal."""
    return float(np.mean(np.abs(np.array(periods) - PERIOD) <= 0.2 * PERIOD))


if __name__ == "__main__":
    main()
