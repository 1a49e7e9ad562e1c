"""What the bridge to ROS 2 costs planner and executor: the same goals with and without it, in turn.

python -m tests.benchmarks.daemon.bridge [--goals N] [--json PATH]

The bridge is a process of its own between the planner and a router. A node of ROS 2's network hears all that the
bridge publishes. `own` is the time from a goal's put to its SYNC without the search. `load` is the planner's processor
time over the time of its goals.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import numpy as np
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.benchmarks.daemon.chain.parts import Parts
from tests.benchmarks.daemon.goal_latency import WARM, Times, send, steps_of
from tests.benchmarks.harness import CommandLine, percentiles, processor_time, report
from tests.endpoints import free_endpoint
from tests.network.played import Router
from tests.waiting import eventually

ROUNDS = 4  # with and without the bridge, in turn
MOST_STATES = 50.0  # bar [Hz] of joint_states
MOST_SLOWER = 1.1  # bar: median of `own` with the bridge over that without
HEARD = (
    ("joint_states", "sensor_msgs/msg/JointState", qos.DEFAULT),
    ("tip_pose", "geometry_msgs/msg/PoseStamped", qos.DEFAULT),
    ("/tf", "tf2_msgs/msg/TFMessage", qos.TF),
    ("visualization_marker_array", "visualization_msgs/msg/MarkerArray", qos.DEFAULT),
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", qos.DEFAULT),
)


class Round(NamedTuple):
    """One round of goals.

    Attributes:
        puts: time of each goal, shape (n,) [s].
        pings: time of the ping before each goal, shape (n,) [s].
        load: the planner's processor time over the time of the round.
        states: rate of joint_states [Hz].
    """

    bridged: bool
    puts: Times
    pings: Times
    load: float
    states: float


def main() -> None:
    options = CommandLine(__doc__, goals=100).parse()
    with ExitStack() as closing:
        router = Router(closing)
        parts = closing.enter_context(Parts(real_time=True))
        ros = closing.enter_context(Session(router.endpoint))
        endpoint = free_endpoint()
        parts.start("listener", endpoint, said=True)
        heard = heard_by(Node(ros, "listener", f"/{parts.name}"))
        with zenoh.open(session.configuration("client", connect=endpoint)) as bare:
            send(parts, bare, WARM)
            rounds = []
            for k in range(ROUNDS):
                with bridge(parts, router, heard) if k % 2 else nothing():
                    rounds.append(one_round(parts, bare, options.goals, heard, bridged=bool(k % 2)))
    figures = {
        name: figures_of(parts, [it for it in rounds if it.bridged is bridged])
        for name, bridged in (("without", False), ("with", True))
    }
    ratio = figures["with"]["own"]["p50"] / figures["without"]["own"]["p50"]
    bars = {
        f"the median is at most {MOST_SLOWER:g} times as long with the bridge": ratio <= MOST_SLOWER,
        f"at most {MOST_STATES:g} joint_states a second": figures["with"]["joint_states"] <= 1.02 * MOST_STATES,
    }
    report({**figures, "ratio of medians": round(ratio, 3)}, bars, options.json)


def heard_by(node: Node) -> list[str]:
    heard: list[str] = []
    for topic, type_name, quality in HEARD:
        node.subscriber(topic, type_name, lambda _, topic=topic: heard.append(topic), quality)
    return heard


@contextmanager
def bridge(parts: Parts, router: Router, heard: list[str]) -> Iterator[None]:
    """Runs the bridge; all topics have come when the context begins."""
    heard.clear()
    command = [sys.executable, "-m", "hyperbit", "ros2", parts.name, "--connect", parts.endpoint]
    environment = {**os.environ, "STATE_DIRECTORY": str(parts.folder), "NOTIFY_SOCKET": ""}
    with (parts.folder / "bridge.log").open("w") as log:
        process = subprocess.Popen([*command, "--ros", router.endpoint], env=environment, stdout=log, stderr=log)
    try:
        eventually(lambda: {it[0] for it in HEARD} <= set(heard))
        yield
    finally:
        process.terminate()
        process.wait(30)


@contextmanager
def nothing() -> Iterator[None]:
    yield


def one_round(parts: Parts, bare: zenoh.Session, count: int, heard: list[str], *, bridged: bool) -> Round:
    heard.clear()
    began, busy = time.monotonic(), processor_time(parts.processes["planner"].pid)
    puts, pings = send(parts, bare, count)
    took, busy = time.monotonic() - began, processor_time(parts.processes["planner"].pid) - busy
    return Round(bridged, puts, pings, busy / took, heard.count("joint_states") / took)


def figures_of(parts: Parts, rounds: list[Round]) -> dict[str, Any]:
    """Returns the figures of the rounds that had the bridge, or of those that had not."""
    pairs = [pair for it in rounds for pair in zip(it.puts, it.pings, strict=True)]
    steps = [step for step in (steps_of(parts, put, ping) for put, ping in pairs) if step]
    own = np.array([step["put to sync"] - step["search"] for step in steps])
    return {
        "goals": len(steps),
        "own": percentiles(own, "p50", "p95", "p99"),
        "load": round(float(np.mean([it.load for it in rounds])), 4),
        "joint_states": round(float(np.mean([it.states for it in rounds])), 2),
    }


if __name__ == "__main__":
    main()
