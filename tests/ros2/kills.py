"""Kills bridge, router, planner, executor, or both of these, while a goal of an action client runs.

Each accepted goal has exactly one result.

python -m tests.ros2.kills [--each 20] [router bridge ...]
"""

import argparse
from collections import Counter
from contextlib import ExitStack

from tests.ros2.client import tip
from tests.ros2.processes import PATIENCE, VICTIMS, System
from tests.waiting import eventually

HOUR = 3600.0
GOES_ON = ("router", "bridge")  # the goal runs on, until its client cancels it


def kill(system: System, victim: str) -> str:
    """Kills while a goal of an hour runs; returns how the goal ended."""
    system.await_ready()
    client = system.tip
    goal, accepted = system.begin(client, tip((1.4, 2.3), (-1.4, 2.3), step=HOUR))
    assert accepted, system.said[-5:]
    eventually(lambda: [it for it in client.feedback if bytes(it.goal_id.uuid) == goal], PATIENCE)
    system.kill(victim)
    if victim in GOES_ON:
        eventually(lambda: system.canceled(client, goal), PATIENCE, every=0.1)
    result = system.result(client, goal)
    assert system.result(client, goal) == result, "one goal, one result"
    return result.error_string.partition(":")[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="kills of each")
    parser.add_argument("victims", nargs="*", help="what is killed; by default each in turn")
    options = parser.parse_args()
    with ExitStack() as closing:
        system = System(closing)
        for victim in options.victims or ("router", *VICTIMS):
            ends = Counter(kill(system, victim) for _ in range(options.each))
            print(f"{victim}: {options.each} kills, {dict(ends)}", flush=True)


if __name__ == "__main__":
    main()
