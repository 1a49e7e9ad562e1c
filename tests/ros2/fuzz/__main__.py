"""Fuzzes the bridge to ROS 2: python -m tests.ros2.fuzz [--messages 1000000] [--seed 0].

Requests and answers of the daemon get lost, and the bridge is killed. A judge sees what clients and daemon see. No
input may raise, move the arm without being a goal, be lost without a word, or let a table grow.
"""

import argparse
import random
import tempfile
import time
from pathlib import Path

from tests.ros2.fuzz.inputs import Inputs
from tests.ros2.fuzz.world import World


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        world = World(Inputs(random.Random(options.seed)), Path(folder))
        began = time.monotonic()
        world.run(options.messages)
        seconds = time.monotonic() - began
    accepted = sum(it.accepted for it in world.judge.actions.values())
    print(f"{options.messages:,} messages in {seconds:.0f} s, {options.messages / seconds:,.0f} a second")
    print(", ".join(f"{name} {count:,}" for name, count in world.counts.most_common()))
    print(f"goals: {accepted:,} accepted and ended; sentences {world.network.words:,}; kills {world.kills:,}")
    print(f"at most {world.largest:,} entries in all tables of the bridge")


if __name__ == "__main__":
    main()
