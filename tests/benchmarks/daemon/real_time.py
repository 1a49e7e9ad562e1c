"""Lateness of the executor's ticks while the planner works and other processes load all processors.

python -m tests.benchmarks.daemon.real_time [--seconds N] [--json PATH]

The boards are outside of the executor's process. A planner plans without pause: set-points at 200 Hz for two seconds,
then 200 goals a second for two, and queries to plan a curve all the time. One process a processor burns what is left.
"bare" is an empty loop of the same period under the same scheduling, in a process of its own at the same time.
"""

import json
import math
import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hyperbit.controller.network.client import Client, Unanswered
from tests.benchmarks.daemon.chain import Chain
from tests.benchmarks.harness import CommandLine, percentiles, report

RATE, TURN = 200.0, 2.0  # [Hz] of set-points or goals, [s] of each in turn
WAYPOINTS, STEP = 100, 0.07  # of the curve that is planned all the time, and seconds between them
MOST_LATE, MOST_RATIO, MARGIN = 1.0, 3.0, 0.2  # bars: [ms]; times bare's, and [ms] more
MOST_GAP, HEARTBEAT = 2.0, 0.1  # bar: periods between two heartbeats of the master; the period [s]


def place(turn: float) -> tuple[float, float]:
    """Returns a point of an ellipse that the arm reaches."""
    return 0.2 + 0.4 * math.cos(turn), 2.5 + 0.25 * math.sin(turn)


def load(chain: Chain, seconds: float) -> None:
    """Sends set-points and goals in turn for a time [s]."""
    session, began, k = chain.session(), time.monotonic(), 0
    while (t := time.monotonic() - began) < seconds:
        if t % (2 * TURN) < TURN:
            key, payload = "setpoint", {"position": place(0.5 * t), "stamp": time.time()}
        else:
            key, payload = "goal", {"id": str(k), "waypoints": [{"position": place(2.4 * k)}]}
        session.put(f"hyperbit/{chain.name}/{key}", json.dumps(payload))
        k += 1
        time.sleep(max(began + k / RATE - time.monotonic(), 0.0))


@contextmanager
def asking(chain: Chain) -> Iterator[None]:
    """Requests the plan of a curve repeatedly inside the context."""
    over, client = threading.Event(), Client(chain.session(), chain.name)

    def ask() -> None:
        while not over.is_set():
            points = [{"t": STEP * k, "position": place(k)} for k in range(WAYPOINTS)]
            try:
                client.request("plan", {"waypoints": points}, timeout=30.0)
            except Unanswered:
                continue

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def burn() -> None:
    while True:
        pass


@contextmanager
def burning() -> Iterator[None]:
    """Loads each processor with a process inside the context."""
    spawning = multiprocessing.get_context("spawn")
    burners = [spawning.Process(target=burn, daemon=True) for _ in range(os.cpu_count() or 1)]
    for burner in burners:
        burner.start()
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.join()


def main() -> None:
    options = CommandLine(__doc__, seconds=60.0).parse()
    with Chain() as chain:
        said = chain.start("bare", said=True)
        client = chain.client()
        with burning(), asking(chain):
            began = time.monotonic()
            load(chain, options.seconds)
            ended = time.monotonic()
        real_time = client.diagnosed()["real_time"]
        client.ask("cancel")
    ticks, bare, beats = (chain.records[name] for name in ("ticks", "bare", "beats"))
    within = [(it["began"] > began) & (it["began"] < ended) for it in (ticks, bare)]
    executor, empty = percentiles(ticks["late"][within[0]]), percentiles(bare["late"][within[1]])
    gap = float(np.diff(beats["at"][(beats["at"] > began) & (beats["at"] < ended)]).max())
    most = MOST_RATIO * empty["p999"] + MARGIN
    bars = {
        f"p999 of the executor at most {MOST_LATE:g} ms": executor["p999"] <= MOST_LATE,
        f"p999 of the executor at most {MOST_RATIO:g} times bare's and {MARGIN:g} ms": executor["p999"] <= most,
        f"no gap over {MOST_GAP:g} heartbeats": gap <= MOST_GAP * HEARTBEAT,
    }
    figures = {"executor": executor, "bare": empty, "work": percentiles(ticks["work"][within[0]])}
    figures |= {"longest heartbeat gap": round(1e3 * gap, 3), "real_time": real_time, "bare real_time": said}
    report(figures, bars, options.json)


if __name__ == "__main__":
    main()
