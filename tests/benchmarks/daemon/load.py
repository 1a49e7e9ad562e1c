"""The whole arm under load: set-points at 200 Hz in every other two seconds, and 2.5 to 3 goals a second.

python -m tests.benchmarks.daemon.load [--seconds N] [--ordinary] [--json PATH]

Nothing may be lost or late. Executor and planner are what `hyperbit run --simulate` starts: the boards are in the
executor's process. The executor has a real-time priority where that is permitted, but not with --ordinary. An empty
loop of the same period under the same scheduling runs beside it.
"""

import json
import random
import time
from collections import Counter

import numpy as np
import zenoh
from numpy.typing import NDArray

from hyperbit.controller.decoding.decoding import decode
from hyperbit.controller.program import TICK
from tests.benchmarks.daemon.chain.parts import Parts
from tests.benchmarks.daemon.real_time import place
from tests.benchmarks.harness import CommandLine, percentiles, report

RATE, TURN = 200.0, 2.0  # [Hz] of set-points, [s] with and without
GOAL_EVERY = 0.33, 0.4  # [s], drawn anew for each
ANSWERED = 15.0  # [s] after the last goal, for answers and results
LONGEST_PERIOD = 0.012  # bar [s]
SHOWN = 8  # longest periods that are told of


class Goals:
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
                self.answers[goal] = decode(reply.ok.payload.to_bytes())["accepted"]

        self._session.get(self._key, take, payload=payload, timeout=10.0)

    @property
    def accepted(self) -> set[str]:
        return {goal for goal, accepted in self.answers.items() if accepted}

    @property
    def complete(self) -> bool:
        """Whether each goal has one answer, and each accepted goal one result."""
        return len(self.answers) == self.sent and self.accepted <= self.results.keys()

    def _hear(self, sample: zenoh.Sample) -> None:
        result = decode(sample.payload.to_bytes())
        self.results[str(result["id"])] += 1
        self.statuses[result["status"]] += 1


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--ordinary", action="store_true", help="no real-time priority")
    options = parser.parse()
    with Parts(simulate=True, real_time=not options.ordinary) as parts:
        client = parts.client()
        parts.start("bare", "ordinary" if options.ordinary else "real-time", said=True)
        began = time.monotonic()
        goals = load(parts, options.seconds)
        ended = time.monotonic()
        mode, real_time = client.state["mode"], client.diagnosed()["real_time"]
    accepted, results = goals.accepted, sum(goals.results[goal] for goal in goals.accepted)
    ticks, empty = parts.record("ticks"), parts.record("bare")["began"]
    within = (ticks["began"] > began) & (ticks["began"] < ended)
    periods = np.diff(ticks["began"][within])
    bare = np.diff(empty[(empty > began) & (empty < ended)])
    long = int((periods > LONGEST_PERIOD).sum())
    bars = {
        f"no period over {1e3 * LONGEST_PERIOD:g} ms": long == 0,
        "as many results as accepted goals": len(accepted) == results,
    }
    whole = {
        "periods": len(periods),
        "long periods": long,
        "period": percentiles(periods),
        "longest": longest({name: column[within] for name, column in ticks.items()}, empty),
        "long periods of an empty loop": int((bare > LONGEST_PERIOD).sum()),
        "period of an empty loop": percentiles(bare),
        "goals": {"sent": goals.sent, "answers": len(goals.answers), "accepted": len(accepted)}
        | {"results": results, "mode at the end": mode, **goals.statuses},
        "real_time": real_time,
    }
    report(whole, bars, options.json)


def longest(ticks: dict[str, NDArray[np.float64]], empty: NDArray[np.float64]) -> list[dict[str, float]]:
    """Returns the longest periods [ms], with the work of the tick before and the empty loop's period at that time."""
    periods, told = np.diff(ticks["began"]), []
    for k in np.argsort(-periods)[:SHOWN]:
        beside = empty[(empty > ticks["began"][k] - TICK) & (empty < ticks["began"][k + 1] + 2 * TICK)]
        row = {"period": periods[k], "work before": ticks["work"][k], "late": ticks["late"][k + 1]}
        row["empty loop"] = float(np.diff(beside).max(initial=0.0))
        told.append({name: round(1e3 * float(value), 2) for name, value in row.items()})
    return told


def load(parts: Parts, seconds: float) -> Goals:
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


if __name__ == "__main__":
    main()
