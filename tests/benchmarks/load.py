"""The whole arm under load: set-points, goals, floods of bad requests, and stops. Nothing may be lost or late.

python -m tests.benchmarks.load [--seconds N] [--stops N] [--json PATH]

Executor and planner are what `hyperbit run --simulate` starts: the boards are in the executor's process, and nothing
has a real-time priority. Three parts follow one another:

1. For the given time, set-points at 200 Hz in every other two seconds, and 2.5 to 3 goals a second.
2. A curve of 40 waypoints; once it is accepted, three processes send bad goals as fast as they can.
3. Stops in the middle of curves.
"""

import argparse
import json
import random
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from controller.gateway.client import decoded
from tests.benchmarks.chain.parts import ROOT, Parts, report
from tests.benchmarks.chain.records import figures
from tests.benchmarks.real_time import place
from tests.system.observer import Observer
from tests.waiting import eventually

RATE, TURN = 200.0, 2.0  # [Hz] of set-points, [s] with and without
GOAL_EVERY = 0.33, 0.4  # [s], drawn anew for each
ANSWERED = 15.0  # [s] after the last goal, for answers and results
WAYPOINTS, STEP, FLOODS = 40, 0.1, 3
LONGEST_PERIOD, LONGEST_STOP, NEARLY_ALL = 0.012, 0.010, 0.95  # bars: [s], [s], share of stops

FLOOD = """
import sys, zenoh
from controller.gateway import session
with zenoh.open(session.configuration("client", connect=sys.argv[1])) as opened:
    sys.stdin.readline()
    while True:
        opened.put(f"hyperbit/{sys.argv[2]}/goal", b'{"waypoints": [{"position": [NaN, 1]}]}')
"""


class Goals:
    """Sends goals without waiting for them; counts what becomes of each."""

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self._session, self._key = session, f"hyperbit/{name}/goal"
        self.sent = 0
        self.answers: dict[str, bool] = {}
        self.results: Counter[str] = Counter()
        self.statuses: Counter[str] = Counter()
        self._hearing = session.declare_subscriber(f"hyperbit/{name}/result", self._hear)

    def send(self) -> None:
        goal = f"load{self.sent}"
        self.sent += 1
        payload = json.dumps({"id": goal, "waypoints": [{"position": place(2.4 * self.sent)}]})

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self.answers[goal] = decoded(reply.ok)["accepted"]

        self._session.get(self._key, take, payload=payload, timeout=10.0)

    @property
    def accepted(self) -> set[str]:
        return {goal for goal, accepted in self.answers.items() if accepted}

    @property
    def complete(self) -> bool:
        """Whether each goal has its answer, and each that was accepted one result."""
        return len(self.answers) == self.sent and self.accepted <= self.results.keys()

    def _hear(self, sample: zenoh.Sample) -> None:
        result = decoded(sample)
        self.results[str(result["id"])] += 1
        self.statuses[result["status"]] += 1


def main() -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--stops", type=int, default=50)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with Parts(simulate=True) as parts:
        client = parts.client()
        parts.start("bare", "ordinary", said=True)
        began = time.monotonic()
        goals = load(parts, options.seconds)
        ended = time.monotonic()
        mode = client.state["mode"]
        client.reset()  # the machine may have stood still for so long that the boards were without the executor
        curve = flooded(parts, client)
        puts = stop_often(parts, client, options.stops)
    accepted, results = goals.accepted, sum(goals.results[goal] for goal in goals.accepted)
    periods, bare = (
        np.diff(times[(times > began) & (times < ended)])
        for times in (parts.record("ticks")["began"], parts.record("bare")["began"])
    )
    halts = parts.record("halts")["at"]
    stops = np.array([halts[np.searchsorted(halts, put)] - put for put in puts])
    long, prompt = int((periods > LONGEST_PERIOD).sum()), float((stops <= LONGEST_STOP).mean())
    bars = {
        f"no period over {1e3 * LONGEST_PERIOD:g} ms": long == 0,
        "as many results as accepted goals": len(accepted) == results,
        f"{WAYPOINTS} feedbacks and one result under floods": curve["feedbacks"] == WAYPOINTS and curve["results"] == 1,
        f"{NEARLY_ALL:.0%} of the stops within {1e3 * LONGEST_STOP:g} ms": prompt >= NEARLY_ALL,
    }
    whole = {
        "periods": len(periods),
        "long periods": long,
        "period": figures(periods),
        "long periods of an empty loop": int((bare > LONGEST_PERIOD).sum()),
        "period of an empty loop": figures(bare),
        "goals": {"sent": goals.sent, "answers": len(goals.answers), "accepted": len(accepted)}
        | {"results": results, "mode at the end": mode, **goals.statuses},
        "curve": curve,
        "stop": figures(stops),
        "stops within the bar": prompt,
    }
    report(whole, bars, options.json)


def load(parts: Parts, seconds: float) -> Goals:
    """Sends set-points and goals for so long."""
    session, drawn = parts.session(), random.Random(20)
    goals, began, next_goal, k = Goals(session, parts.name), time.monotonic(), 0.0, 0
    while (t := time.monotonic() - began) < seconds:
        if t % (2 * TURN) < TURN:
            payload = {"position": place(0.5 * t), "stamp": time.time()}
            session.put(f"hyperbit/{parts.name}/setpoint", json.dumps(payload))
        if t >= next_goal:
            next_goal = t + drawn.uniform(*GOAL_EVERY)
            goals.send()
        k += 1
        time.sleep(max(began + k / RATE - time.monotonic(), 0.0))
    until = time.monotonic() + ANSWERED
    while not goals.complete and time.monotonic() < until:
        time.sleep(0.1)
    return goals


def flooded(parts: Parts, client: Observer) -> dict[str, Any]:
    """Runs a curve under floods; returns what was heard of it."""
    command = [sys.executable, "-c", FLOOD, parts.endpoint, parts.name]
    with ExitStack() as stack:
        floods = [subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, text=True) for _ in range(FLOODS)]
        for flood in floods:
            stack.callback(flood.wait)
            stack.callback(flood.kill)
        time.sleep(2.0)  # until they are connected
        answer = client.goal(*(place(0.2 * k) for k in range(WAYPOINTS)), times=times(), id="flooded")
        for flood in floods:
            assert flood.stdin
            flood.stdin.close()
        if answer["accepted"]:
            client.result("flooded")
        time.sleep(1.0)
    told = {"feedbacks": len(client.feedback("flooded")), "results": len(client.results("flooded"))}
    refused = sum(result["id"] is None for result in client.heard["result"])
    return {**told, "answer": answer["message"], "refusals of others": refused}


def times() -> list[float]:
    """Returns when the waypoints of a curve are due [s]."""
    return [STEP * k for k in range(WAYPOINTS)]


def stop_often(parts: Parts, client: Observer, count: int) -> list[float]:
    """Stops curves and resets; returns when each stop was put [s]."""
    session, drawn, puts = parts.session(), random.Random(50), []
    time.sleep(1.0)
    for _ in range(count):
        eventually(lambda: client.goal(*(place(0.2 * n) for n in range(WAYPOINTS)), times=times())["accepted"])
        time.sleep(drawn.uniform(0.05, 0.6))
        puts.append(time.monotonic())
        session.put(f"hyperbit/{parts.name}/stop", b"")
        client.wait_now("stopped")
        client.reset()
    return puts


if __name__ == "__main__":
    main()
