"""Fuzzes the bridge to ROS 2: python -m tests.ros2.world [--messages 1000000] [--seed 0].

Requests and answers of the daemon get lost, and the bridge is killed. A judge sees what clients and daemon see. No
input may raise, move the arm without being a goal, be lost without a word, or let a table grow.
"""

import argparse
import tempfile
import time
from pathlib import Path

from tests.ros2.world.world import World


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        world = World(Path(folder), options.seed)
        began = time.monotonic()
        world.run(options.messages)
        seconds = time.monotonic() - began
    print(f"{options.messages:,} messages in {seconds:.0f} s, {options.messages / seconds:,.0f} a second")
    print(", ".join(f"{name} {count:,}" for name, count in world.counts.most_common()))
    print(f"{world.judge.accepted:,} goals accepted and ended; sentences {world.network.published['rosout']:,}")
    print(f"at most {world.largest:,} entries in all tables of the bridge")


if __name__ == "__main__":
    main()
