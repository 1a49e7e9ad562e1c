"""An empty loop of the executor's period, under the same scheduling.

python -m tests.benchmarks.daemon.chain.bare RECORDS real-time|ordinary. RECORDS is a folder: bare.npz has a row for
each turn. It waits in the same way as the executor. Its lateness is caused by the machine and by Python, not by the
executor.
"""

import gc
import select
import signal
import sys
import time
from pathlib import Path

from hyperbit.controller.armfile.settings import RealTimeSettings
from hyperbit.controller.executor.process.real_time import enter_real_time
from hyperbit.controller.program import TICK
from tests.benchmarks.daemon.chain.records import Record

AHEAD = 1  # of the executor's default priority: it does nothing, and must not wait for the executor's tick


def main(folder: Path, real_time: bool) -> None:
    ending: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ending.append(number))
    with Record(folder / "bare.npz", "began", "late") as record:
        settings = RealTimeSettings(RealTimeSettings().priority + AHEAD) if real_time else None
        print(enter_real_time(settings), flush=True)
        gc.freeze()
        gc.disable()
        due = time.monotonic()
        while not ending:
            while (left := due - time.monotonic()) > 0:
                select.select([], [], [], left)
            began = time.monotonic()
            record.note(began, began - due)
            due = max(due + TICK, began)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2] == "real-time")
