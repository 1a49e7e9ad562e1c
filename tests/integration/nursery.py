"""A process that forks daemons, so that a test can kill many: python -m tests.integration.nursery

Arguments: the arm's file, and the folder of the densities. Each line on the standard input begins a daemon: interface
and channel of the bus, endpoint, ledger and journal as a list in JSON; its process id is printed. All that daemons need
is imported and computed before.
"""

import json
import logging
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import filterpy.kalman  # noqa: F401  # most of a second, which each daemon would spend

from controller.config import load
from controller.daemon import session
from controller.daemon.service import Daemon, run_until_signal, wiring_of
from controller.search.solver import Solver
from controller.workspace.cache import load_or_map
from drivers.wiring import BusSettings
from tests import emulated  # noqa: F401
from tests.integration.conftest import bearing


def main(file: str, folder: str) -> None:
    arm = load(Path(file))
    densities = load_or_map(arm.manipulator, 0.02, arm.level_pixels, Path(folder))
    Solver(arm.manipulator, densities).prepare()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the dead are not waited for
    print("ready", flush=True)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            interface, channel, endpoint, ledger, journal = json.loads(line)
            logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", filename=journal)
            wiring = replace(wiring_of(arm), buses=(BusSettings("can0", interface, channel),))
            config = session.configuration("peer", listen=endpoint)
            run_until_signal(Daemon(arm, densities, wiring, config, Path(ledger), bearing(arm)))
            os._exit(0)
        print(child, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
