"""The executor's process: `python -m hyperbit.controller.executor ARM.yaml --socket PATH`; see `hyperbit execute`."""

from __future__ import annotations

import argparse
import contextlib
import logging
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.process.buses import CanBuses
from hyperbit.controller.executor.process.journal_file import FileJournal, default_path
from hyperbit.controller.executor.process.real_time import enter_real_time
from hyperbit.controller.executor.process.run import MOST_PENDING, EventLoop
from hyperbit.controller.executor.process.server import ExecutorServer
from hyperbit.controller.flight_recorder import FlightRecorder, Label
from hyperbit.controller.host.journal import start_logging
from hyperbit.controller.host.keeper import FileInUse
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.host.signals import ENDING, end_on_signals, ignore
from hyperbit.controller.host.sockets import socket_path
from hyperbit.drivers.canopen.faults import BusError

if TYPE_CHECKING:
    from hyperbit.controller.executor.process.embedded_boards import EmbeddedBoards

log = logging.getLogger("executor")


def main(arguments: list[str] | None = None) -> int:
    """Runs the executor until SIGTERM; returns the exit code: 0 done, 1 failed, 2 unusable input."""
    parser = argparse.ArgumentParser(prog="hyperbit execute", description="Runs the executor of an arm until SIGTERM.")
    parser.add_argument("file", metavar="ARM.yaml", type=Path, help="the arm's file")
    parser.add_argument("--socket", type=Path, help="the socket, or its folder")
    parser.add_argument("--simulate", action="store_true", help="simulate the boards in this process")
    parser.add_argument("--board", action="append", default=[], help="variant of the simulated boards")
    parser.add_argument("--wired", type=Path, help="how the simulated boards are wired, as another arm's file")
    parser.add_argument("--journal", type=Path, help="the switch journal")
    parser.add_argument("--list-modules", action="store_true", help="print the names of the loaded modules at the end")
    options = parser.parse_args(arguments)
    try:
        execute(options.file, options.socket, options.simulate, options.journal, options.board, options.wired)
    except InputFaults as error:
        print(error, file=sys.stderr)
        return 2
    except (FileInUse, BusError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    if options.list_modules:
        print("\n".join(sorted(sys.modules)))
    return 0


def execute(
    file: Path,
    socket: Path | None,
    simulate: bool,
    journal: Path | None,
    board: Sequence[str] = (),
    wired: Path | None = None,
) -> None:
    """Runs the executor until SIGTERM. Each path that is None has its default. `main` names the exceptions."""
    arm = read_arm(file)
    boards: EmbeddedBoards | None = None
    if simulate:  # the process of a real arm loads no simulation
        from hyperbit.controller.executor.process.embedded_boards import simulated_boards

        boards = simulated_boards(arm, board, wired)
    elif wired is not None:
        raise InputFaults(wired, ["--wired says how simulated boards are wired: it needs --simulate"])
    elif board:
        raise InputFaults(Path("--board"), ["the variant of a simulated board needs --simulate"])
    start_logging({"HYPERBIT_ARM": arm.name})
    for name in ("can", "canopen"):  # they log each SDO of simulated boards
        logging.getLogger(name).setLevel(logging.WARNING)
    with contextlib.ExitStack() as closing:
        notifier = Notifier()
        path = journal or default_path(arm.name, simulated=simulate)
        kept = notifier.kept_file("simulated-switches" if simulate else "switches")
        counts = FileJournal(path, arm.actuators, kept)
        closing.callback(counts.close)
        counts.start_copier()
        server = ExecutorServer(socket_path(socket, arm.name))
        simulation = boards.simulation() if boards else None
        core = Executor(arm, counts, secrets.randbits(62), notifier.watchdog, simulation)
        label = Label("executor", arm.name, arm.digest)
        recorder = closing.enter_context(FlightRecorder(label, path.parent, batch=MOST_PENDING))
        core.reports.real_time = enter_real_time(arm.real_time)
        buses = boards or CanBuses(arm.wiring.buses)
        if isinstance(buses, CanBuses):
            buses.listen(arm.timing.heartbeat)
        loop = EventLoop(core, buses, server, notifier, recorder=recorder)
        end_on_signals(loop.quit)
        log.info("the boards of %s are %s", arm.name, "simulated in this process" if boards else "on CAN buses")
        loop.run()
        ignore(ENDING)  # a second signal, such as that of a parent's death, must not interrupt the end


if __name__ == "__main__":
    sys.exit(main())
