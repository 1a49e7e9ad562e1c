"""Floods of bad requests, which must not delay the feedback of a running goal or a stop.

python -m tests.benchmarks.daemon.floods [--kinds KIND...] [--stops N] [--json PATH]

For each kind, three processes send bad goals as fast as they can, while a curve of 40 waypoints runs, and while curves
are stopped. Executor and planner are what `hyperbit run --simulate` starts; the executor has a real-time priority
where that is permitted.
"""

import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from tests.benchmarks.daemon.chain.parts import ROOT, Parts
from tests.benchmarks.daemon.real_time import place
from tests.benchmarks.harness import CommandLine, percentiles, report
from tests.system.stack.observer import Observer
from tests.waiting import eventually

WAYPOINTS, STEP, FLOODS = 40, 0.1, 3
LONGEST_STOP, NEARLY_ALL = 0.010, 0.95  # bars: [s], share of stops
BETWEEN = 0.05, 0.6  # [s] from the acceptance of a curve to its stop

# Put or get, and an expression of the payload.
KINDS = {
    "malformed": ("put", """b'{"waypoints": [{"position": [NaN, 1]}]}'"""),
    "large": ("put", """b'{"waypoints": [' + b'{"position": [1, 2]}, ' * 5000 + b'{"position": [NaN, 1]}]}'"""),
    "unreachable": ("put", """b'{"waypoints": [{"position": [90, 90]}]}'"""),
    "asked": ("get", """b'{"waypoints": [{"position": [NaN, 1]}]}'"""),
    "asked, unreachable": ("get", """b'{"waypoints": [{"position": [90, 90]}]}'"""),
}
PUT = "session.put(key, payload)"
GET = "free.acquire(); session.get(key, zenoh.handlers.Callback(lambda _: None, free.release), payload=payload)"

FLOOD = """
import sys, threading, zenoh
from hyperbit.controller.network import session as sessions
session = zenoh.open(sessions.configuration("client", connect=sys.argv[1]))
key, payload, free, sent = sys.argv[2], {payload}, threading.Semaphore(200), 0
threading.Thread(target=lambda: (sys.stdin.readline(), print(sent, flush=True), __import__("os")._exit(0))).start()
while True:
    {send}
    sent += 1
"""


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--stops", type=int, default=50)
    options = parser.parse()
    curves: dict[str, dict[str, Any]] = {}
    puts: dict[str, list[float]] = {}
    with Parts(simulate=True, real_time=True) as parts:
        client = parts.client()
        puts["none"] = stop_often(parts, client, options.stops)
        for kind in options.kinds:
            with flooding(parts, kind) as sent:
                curves[kind] = curve(client, kind)
                puts[kind] = stop_often(parts, client, options.stops)
            curves[kind] |= {"sent": sum(sent)}
        real_time = parts.client().diagnosed()["real_time"]
    halts = parts.record("halts")["at"]
    stops = {
        kind: np.array([halts[np.searchsorted(halts, put)] - put for put in times]) for kind, times in puts.items()
    }
    bars: dict[str, bool] = {}
    for kind, told in curves.items():
        bars[f"{kind}: {WAYPOINTS} feedbacks, one result"] = (told["feedbacks"], told["results"]) == (WAYPOINTS, 1)
        prompt = float((stops[kind] <= LONGEST_STOP).mean())
        bars[f"{kind}: {NEARLY_ALL:.0%} of the stops within {1e3 * LONGEST_STOP:g} ms"] = prompt >= NEARLY_ALL
    took = {kind: percentiles(times, "p50", "p95", "p99", "worst") for kind, times in stops.items()}
    report({"curves": curves, "stops": took, "real_time": real_time}, bars, options.json)


@contextmanager
def flooding(parts: Parts, kind: str) -> Iterator[list[int]]:
    """Floods the daemon inside the context; afterwards the list has the number of requests of each process."""
    how, payload = KINDS[kind]
    program = FLOOD.format(payload=payload, send=PUT if how == "put" else GET)
    command, sent = [sys.executable, "-c", program, parts.endpoint, f"hyperbit/{parts.name}/goal"], list[int]()
    with ExitStack() as stack:
        floods = [
            subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(FLOODS)
        ]
        for flood in floods:
            stack.callback(flood.wait)
            stack.callback(flood.kill)
        time.sleep(2.0)  # until all are connected
        yield sent
        for flood in floods:
            sent.append(int(flood.communicate("\n", timeout=30)[0]))


def curve(client: Observer, kind: str) -> dict[str, Any]:
    goal, began = f"flooded by {kind}", time.monotonic()
    answer = eventually(lambda: it if (it := run(client, goal))["accepted"] else None)
    accepted = time.monotonic()
    result = client.result(goal)
    ended = time.monotonic()
    time.sleep(1.0)  # a second result would come
    told = {"feedbacks": len(client.feedback(goal)), "results": len(client.results(goal)), "status": result["status"]}
    waited = {"until accepted": round(accepted - began, 3), "until the result": round(ended - accepted, 3)}
    refused = sum(result["id"] is None for result in client.heard["result"])
    return {**told, **waited, "answer": answer["message"], "refusals of others": refused}


def run(client: Observer, goal: str) -> dict[str, Any]:
    positions = (place(0.2 * k) for k in range(WAYPOINTS))
    return client.goal(*positions, times=[STEP * k for k in range(WAYPOINTS)], id=goal)


def stop_often(parts: Parts, client: Observer, count: int) -> list[float]:
    """Stops curves and resets; returns the time of each stop's put [s]."""
    session, drawn, puts = parts.session(), random.Random(50), list[float]()
    time.sleep(1.0)
    for k in range(count):
        run(client, f"stopped {k} {time.monotonic()}")  # a flood of goals may leave no place for it: then the arm holds
        time.sleep(drawn.uniform(*BETWEEN))
        puts.append(time.monotonic())
        session.put(f"hyperbit/{parts.name}/stop", b"")
        client.wait_now("stopped")
        client.reset()
    return puts


if __name__ == "__main__":
    main()
