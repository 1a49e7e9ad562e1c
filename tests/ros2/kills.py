"""Kills bridge, router, planner, executor, or both of these, while goals of an action client run.

Each accepted goal has exactly one result.

python -m tests.ros2.kills [--each 20] [router bridge ...]
"""

import argparse
import tempfile
import threading
import time
import uuid
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from tests.ros2.client import Client, Result
from tests.ros2.rig import Rig, begin, result_of

VICTIMS = {"bridge": ["bridge"], "planner": ["planner"], "executor": ["executor"], "daemon": ["executor", "planner"]}
PLACES = ((1.4, 2.3), (-1.4, 2.3))


def kill(rig: Rig, victim: str) -> None:
    if victim == "router":
        rig.router.stop()
        time.sleep(0.3)
        rig.router.start()
        return
    for name in VICTIMS[victim]:
        rig.kill(name)
    for name in VICTIMS[victim]:
        rig.start(name)


def goal_with_kill(rig: Rig, client: Client, victim: str, number: int) -> Result | None:
    goal = uuid.uuid4().bytes
    if not begin(client, goal, *PLACES[number % 2]):
        return None
    found: list[Result] = []
    waiting = threading.Thread(target=lambda: found.append(result_of(client, goal)))
    waiting.start()
    kill(rig, victim)
    waiting.join()
    assert found, f"goal {goal.hex()} has no result: {rig.said[-5:]}, {rig.log('bridge')}, {rig.log('planner')[-2000:]}"
    again = result_of(client, goal)
    assert again == found[0], f"two results of one goal: {found[0]} and {again}"
    return again


def run(rig: Rig, victim: str, each: int) -> Counter[str]:
    ends: Counter[str] = Counter()
    client = rig.client()
    number = 0
    while ends.total() - ends["rejected"] < each:
        rig.await_ready()
        result = goal_with_kill(rig, client, victim, number)
        ends["rejected" if result is None else result.error_string.partition(":")[0]] += 1
        number += 1
    return ends


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="kills of each")
    parser.add_argument("victims", nargs="*", help="what is killed; by default each in turn")
    options = parser.parse_args()
    with ExitStack() as closing:
        rig = Rig(Path(closing.enter_context(tempfile.TemporaryDirectory())), closing, travel_time=1.0)
        for victim in options.victims or ("router", *VICTIMS):
            print(f"{victim}: {options.each} kills, {dict(run(rig, victim, options.each))}", flush=True)


if __name__ == "__main__":
    main()
