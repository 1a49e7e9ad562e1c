"""The load of `hyperbit fleet`, and the time of a stop for all, with many played arms behind a router on loopback.

python -m tests.benchmarks.daemon.fleet [--arms 20,50] [--json PATH]
"""

import os
import pty
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import zenoh

from hyperbit.controller.network.stop_all import stop_all
from tests import told
from tests.benchmarks.harness import CommandLine, processor_time, report, timed
from tests.network.played import PlayedArm, Router

SETTLED, MEASURED = 5.0, 8.0  # [s] before a measurement, and of it
STATE = told.state()


def publish(arms: list[PlayedArm], ending: threading.Event) -> None:
    while not ending.wait(0.05):
        for arm in arms:
            arm.put("state", STATE)


def load(endpoint: str) -> float:
    """Returns the share of a processor that the command takes in a terminal."""
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "hyperbit", "fleet", "--connect", endpoint]
    with subprocess.Popen(command, stdin=follower, stdout=follower, stderr=follower) as process:
        threading.Thread(target=lambda: [os.read(leader, 1 << 16) for _ in iter(int, 1)], daemon=True).start()
        time.sleep(SETTLED)
        before = processor_time(process.pid)
        time.sleep(MEASURED)
        share = (processor_time(process.pid) - before) / MEASURED
        process.send_signal(2)
    return share


def main() -> None:
    given, figures, bars = CommandLine(__doc__, arms="20,50").parse(), {}, {}
    for count in map(int, given.arms.split(",")):
        with ExitStack() as stack:
            router, ending = Router(stack), threading.Event()
            arms = [PlayedArm(stack, router.client(f"cell{k // 10}"), f"arm{k % 10}") for k in range(count)]
            publishing = threading.Thread(target=publish, args=(arms, ending))
            publishing.start()
            stack.callback(publishing.join)
            stack.callback(ending.set)
            share = load(router.endpoint)
            with zenoh.open(router.client()) as session:
                stopped, seconds = timed(lambda session=session: stop_all(session))
        figures[f"{count} arms"] = {"fleet, share of a processor": share, "all have answered a stop after [s]": seconds}
        bars[f"all {count} have stopped"] = stopped.complete and len(stopped.answers) == count
    report(figures, bars, given.json)


if __name__ == "__main__":
    main()
