"""A bare subscriber of Zenoh: python -m tests.benchmarks.daemon.chain.listener RECORDS ENDPOINT.

RECORDS is a folder: pings.npz has a row for each sample on "ping/goal", when its callback began.
"""

import signal
import sys
import threading
import time
from pathlib import Path

import zenoh

from hyperbit.controller.network import session
from tests.benchmarks.daemon.chain.records import Record


def main(folder: Path, endpoint: str) -> None:
    ending = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ending.set())
    config = session.configuration("peer", listen=endpoint)
    with Record(folder / "pings.npz", "at") as record, zenoh.open(config) as opened:
        opened.declare_subscriber("ping/goal", lambda sample: record.note(time.monotonic()))
        print("ready", flush=True)
        while not ending.wait(0.2):
            pass


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
