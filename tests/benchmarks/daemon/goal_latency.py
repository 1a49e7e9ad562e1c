"""Time of planner and executor for a goal: from its put to its SYNC, without the search and Zenoh's transport.

python -m tests.benchmarks.daemon.goal_latency [--goals N] [--json PATH]

Client, planner, executor and boards are processes of their own; all read the same clock. Zenoh's own one-way time is
that of a put to a bare subscriber in another process, taken before each goal.
"""

import json
import sys
import time

import numpy as np
import zenoh
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.network import session
from tests.benchmarks.daemon.chain import Chain
from tests.benchmarks.harness import CommandLine, percentiles, report
from tests.benchmarks.solving import random_tips
from tests.endpoints import free_endpoint

MEDIAN, NEARLY_ALL = 1.0, 3.0  # bars: [ms] of half of the goals and of 99 % of them
WARM = 20  # goals before those that count
REST = 0.1  # [s] between a result and the next goal: the planner prepares for it meanwhile

Times = NDArray[np.float64]


def send(chain: Chain, bare: zenoh.Session, count: int) -> tuple[Times, Times]:
    """Sends goals one by one; returns the times of each put and of the ping before it, shapes (count,) [s]."""
    client, observer, puts, pings = chain.session(), chain.client(), np.zeros(count), np.zeros(count)
    time.sleep(1.0)  # the subscriptions are known everywhere
    for k, tip in enumerate(random_tips(load(chain.file).manipulator, count, seed=7).tolist()):
        payload = json.dumps({"id": f"g{k}", "waypoints": [{"position": tip}]})
        pings[k] = time.monotonic()
        bare.put("ping/goal", payload)
        time.sleep(REST / 2)
        puts[k] = time.monotonic()
        client.put(f"hyperbit/{chain.name}/goal", payload)
        result = observer.result(f"g{k}")
        if result["status"] != "succeeded":  # the machine stood still for longer than the boards wait
            print(result["message"], file=sys.stderr)
            observer.reset()
        time.sleep(REST / 2)
    return puts, pings


def after(times: Times, time: float) -> float:
    """Returns the first of sorted times that is later than another; infinity if there is none."""
    k = int(np.searchsorted(times, time, side="right"))
    return float(times[k]) if k < len(times) else np.inf


def main() -> None:
    options = CommandLine(__doc__, goals=200).parse()
    with Chain() as chain:
        endpoint = free_endpoint()
        chain.start("listener", endpoint, said=True)
        with zenoh.open(session.configuration("client", connect=endpoint)) as bare:
            puts, pings = send(chain, bare, options.goals + WARM)
        real_time = chain.client().diagnosed()["real_time"]
    solves, ways, rows = chain.records["solves"], [], []
    for put, ping in list(zip(puts, pings, strict=True))[WARM:]:
        sync = after(chain.records["syncs"]["at"], put)
        if sync - put <= 0.5:  # otherwise the goal switched no actuator
            own = (solves["began"] > put) & (solves["ended"] < sync)
            ways.append(after(chain.records["pings"]["at"], ping) - ping)
            rows.append((sync - put, float((solves["ended"] - solves["began"])[own].sum())))
    whole, search = np.array(rows).T
    columns = {"own": whole - search - np.median(ways), "put to sync": whole, "search": search, "zenoh": ways}
    figures = {name: percentiles(times, "p50", "p99") for name, times in columns.items()}
    bars = {
        f"half of the goals within {MEDIAN:g} ms": figures["own"]["p50"] <= MEDIAN,
        f"99 % of the goals within {NEARLY_ALL:g} ms": figures["own"]["p99"] <= NEARLY_ALL,
    }
    report({**figures, "goals": len(rows), "real_time": real_time}, bars, options.json)


if __name__ == "__main__":
    main()
