"""Lateness of the executor's ticks while the planner works and other processes load all processors.

python -m tests.benchmarks.daemon.real_time [--seconds N] [--json PATH]

The executor ships as it is measured: a process of its own, on 16 boards outside of it, which another process simulates
on an emulated bus. A planner plans without pause: set-points at 200 Hz for two seconds, then 200 goals a second for
two, and queries to plan a curve all the time. One process a processor burns what is left. "bare" is an empty loop of
the same period under the same scheduling, in a process of its own at the same time.
"""

import json
import math
import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from hyperbit.controller.network.client import Client, Unanswered
from tests.benchmarks.daemon.chain.parts import Parts
from tests.benchmarks.harness import CommandLine, percentiles, report

RATE, TURN = 200.0, 2.0  # [Hz] of set-points or goals, [s] of each in turn
WAYPOINTS, STEP = 100, 0.07  # of the curve that is planned all the time, and seconds between them
MOST_LATE, MOST_RATIO, MARGIN = 1.0, 3.0, 0.2  # bars: [ms]; times bare's, and [ms] more
MOST_GAP = 2.0  # bar: periods of the master's heartbeat between two of them
HEARTBEAT = 0.1  # [s] of the master, as in the arm's file


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse()
    with Parts(real_time=True) as parts:
        said = parts.start("bare", "real-time", said=True)
        client, diagnosed = parts.client(), parts.client().diagnosed()
        with burning(), asking(parts):
            began = time.monotonic()
            sent = load(parts.session(), parts.name, options.seconds)
            ended = time.monotonic()
        diagnosed = client.diagnosed()
        client.ask("cancel")
    ticks, bare, beats = parts.record("ticks"), parts.record("bare"), parts.record("beats")["at"]
    within = {name: (it["began"] > began) & (it["began"] < ended) for name, it in (("t", ticks), ("b", bare))}
    executor, empty = percentiles(ticks["late"][within["t"]]), percentiles(bare["late"][within["b"]])
    gap = float(np.diff(beats[(beats > began) & (beats < ended)]).max())
    most = MOST_RATIO * empty["p999"] + MARGIN
    bars = {
        f"p999 of the executor at most {MOST_LATE:g} ms": executor["p999"] <= MOST_LATE,
        f"p999 of the executor at most {MOST_RATIO:g} times bare's and {MARGIN:g} ms": executor["p999"] <= most,
        f"no gap over {MOST_GAP:g} heartbeats": gap <= MOST_GAP * HEARTBEAT,
    }
    whole = {
        "executor": executor,
        "bare": empty,
        "work": percentiles(ticks["work"][within["t"]]),
        "ticks": int(within["t"].sum()),
        "longest heartbeat gap": round(1e3 * gap, 3),
        "real_time": diagnosed["real_time"],
        "bare real_time": said,
        "sent": sent,
        "set-points": diagnosed["setpoint"],
        "loop": diagnosed["loop"],
    }
    report(whole, bars, options.json)


def load(session: zenoh.Session, name: str, seconds: float) -> dict[str, int]:
    """Sends set-points and goals in turn for a time [s]; returns their numbers."""
    began, k, sent = time.monotonic(), 0, {"setpoint": 0, "goal": 0}
    while (t := time.monotonic() - began) < seconds:
        key = "setpoint" if t % (2 * TURN) < TURN else "goal"
        x, y = place(0.5 * t)
        payload = {"position": [x, y], "stamp": time.time()}
        if key == "goal":
            x, y = place(2.4 * k)
            payload = {"id": str(k), "waypoints": [{"position": [x, y]}]}
        session.put(f"hyperbit/{name}/{key}", json.dumps(payload))
        sent[key] += 1
        k += 1
        time.sleep(max(began + k / RATE - time.monotonic(), 0.0))
    return sent


def place(turn: float) -> tuple[float, float]:
    """Returns a point of an ellipse that the arm reaches."""
    return 0.2 + 0.4 * math.cos(turn), 2.5 + 0.25 * math.sin(turn)


@contextmanager
def asking(parts: Parts) -> Iterator[None]:
    """Requests the plan of a curve repeatedly inside the context."""
    over, client = threading.Event(), Client(parts.session(), parts.name)

    def ask() -> None:
        while not over.is_set():
            points: list[dict[str, Any]] = [{"t": STEP * k, "position": place(k)} for k in range(WAYPOINTS)]
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


if __name__ == "__main__":
    main()
