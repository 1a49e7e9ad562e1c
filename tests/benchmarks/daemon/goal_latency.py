"""Time of planner and executor for a goal: from its put to its SYNC, without the search and Zenoh's transport.

python -m tests.benchmarks.daemon.goal_latency [--goals N] [--json PATH]

Client, planner, executor and boards are processes of their own; all read the same clock. Zenoh's own one-way time is
that of a put to a bare subscriber in another process, taken before each goal.
"""

import json
import queue
import sys
import time
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.decoding.decoding import decode
from hyperbit.controller.network import session
from tests.benchmarks.daemon.chain.parts import Parts
from tests.benchmarks.harness import CommandLine, percentiles, report
from tests.endpoints import free_endpoint

MEDIAN, NEARLY_ALL = 1.0, 3.0  # bars: [ms] of half of the goals and of 99 % of them
WARM = 20  # goals before those that count
REST = 0.1  # [s] between a result and the next goal: the planner prepares for it meanwhile

Times = NDArray[np.float64]


def main() -> None:
    options = CommandLine(__doc__, goals=200).parse()
    with Parts(real_time=True) as parts:
        endpoint = free_endpoint()
        parts.start("listener", endpoint, said=True)
        with zenoh.open(session.configuration("client", connect=endpoint)) as bare:
            puts, pings = send(parts, bare, options.goals + WARM)
        real_time = parts.client().diagnosed()["real_time"]
    steps = [step for step in (steps_of(parts, put, ping) for put, ping in zip(puts, pings, strict=True)) if step]
    table = {name: np.array([step[name] for step in steps[WARM:]]) for name in steps[0]}
    way = float(np.median(table["zenoh"]))
    own = table["put to sync"] - table["search"] - way
    figures = {name: percentiles(times, "p50", "p99") for name, times in {"own": own, **table}.items()}
    bars = {
        f"half of the goals within {MEDIAN:g} ms": figures["own"]["p50"] <= MEDIAN,
        f"99 % of the goals within {NEARLY_ALL:g} ms": figures["own"]["p99"] <= NEARLY_ALL,
    }
    report({**figures, "goals": len(own), "real_time": real_time}, bars, options.json)


def send(parts: Parts, bare: zenoh.Session, count: int) -> tuple[Times, Times]:
    """Sends goals one by one; returns the times of each put and of the ping before it, shapes (count,) [s]."""
    manipulator = load(parts.file).manipulator
    states = np.random.default_rng(7).integers(0, 8, (count, len(manipulator.states)))
    tips = manipulator.tips(states)[:, :2, 3].tolist()
    results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    client, observer = parts.session(), parts.client()
    hearing = client.declare_subscriber(
        f"hyperbit/{parts.name}/result", lambda sample: results.put(decode(sample.payload.to_bytes()))
    )
    puts, pings = np.zeros(count), np.zeros(count)
    time.sleep(1.0)  # the subscriptions are known everywhere
    for k, tip in enumerate(tips):
        payload = json.dumps({"id": f"g{k}", "waypoints": [{"position": tip}]})
        pings[k] = time.monotonic()
        bare.put("ping/goal", payload)
        time.sleep(REST / 2)
        puts[k] = time.monotonic()
        client.put(f"hyperbit/{parts.name}/goal", payload)
        result = results.get(timeout=10.0)
        if result["status"] != "succeeded":  # the machine stood still for longer than the boards wait
            print(result["message"], file=sys.stderr)
            observer.reset()
        time.sleep(REST / 2)
    hearing.undeclare()  # type: ignore[no-untyped-call]
    return puts, pings


def steps_of(parts: Parts, put: float, ping: float) -> dict[str, float] | None:
    """Returns the duration of each step of a goal [s]; None if the goal switched no actuator."""
    sync = after(parts.record("syncs")["at"], put)
    if sync - put > 0.5:
        return None
    goals, programs, services = (parts.record(name) for name in ("goals", "programs", "services"))
    solves = parts.record("solves")
    mine = (solves["began"] > put) & (solves["ended"] < sync)
    came, served = after(goals["began"], put), after(services["began"], put)
    packed = after(programs["began"], put)
    taken = after(parts.record("taken")["at"], packed)
    search = float((solves["ended"] - solves["began"])[mine].sum())
    return {
        "put to sync": sync - put,
        "search": search,
        "zenoh": after(parts.record("pings")["at"], ping) - ping,
        "put to callback": came - put,
        "callback to planner": served - came,
        "planner, without search": packed - served - search,
        "planner to executor": taken - packed,
        "executor to sync": sync - taken,
    }


def after(times: Times, time: float) -> float:
    """Returns the first of sorted times that is later than another; infinity if there is none."""
    k = int(np.searchsorted(times, time, side="right"))
    return float(times[k]) if k < len(times) else np.inf


if __name__ == "__main__":
    main()
