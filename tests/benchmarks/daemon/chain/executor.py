"""The unmodified executor, in a process that also records the times of its ticks and modes.

python -m tests.benchmarks.daemon.chain.executor RECORDS ARM.yaml --socket PATH [--simulate]. The interface "virtual" of
the arm's file is the emulated one. RECORDS is a folder: ticks.npz has a row for each tick, halts.npz one for each halt,
taken.npz one for each program.
"""

import sys
import time
from contextlib import ExitStack
from pathlib import Path

import can.interfaces

from hyperbit.controller.executor.__main__ import main
from hyperbit.controller.executor.core.modes import Modes
from hyperbit.controller.executor.core.requests import ClientRequests
from hyperbit.controller.executor.process.run import Timekeeper
from hyperbit.controller.program import Program
from tests import emulated  # noqa: F401
from tests.benchmarks.daemon.chain.records import Record


def note_ticks(record: Record) -> None:
    """Records begin, lateness and duration of each tick [s]."""
    ticked, note = Timekeeper.ticked, record.note

    def noting(keeper: Timekeeper, began: float, ended: float) -> None:
        note(began, began - keeper.next_tick, ended - began)
        ticked(keeper, began, ended)

    Timekeeper.ticked = noting  # type: ignore[method-assign]


def note_halts(record: Record) -> None:
    """Records the times at which the mode "stopped" began [s]."""
    enter = Modes.enter

    def noting(modes: Modes, mode: str, reason: str) -> None:
        enter(modes, mode, reason)  # type: ignore[arg-type]
        if mode == "stopped":
            record.note(time.monotonic())

    Modes.enter = noting  # type: ignore[method-assign,assignment]


def note_programs(record: Record) -> None:
    """Records the time at which each program was read [s]."""
    take = ClientRequests.receive_program

    def noting(requests: ClientRequests, message: Program, now: float) -> None:
        record.note(time.monotonic())
        take(requests, message, now)

    ClientRequests.receive_program = noting  # type: ignore[method-assign]


if __name__ == "__main__":
    can.interfaces.BACKENDS["virtual"] = ("tests.emulated", "EmulatedBus")
    folder = Path(sys.argv[1])
    with ExitStack() as stack:
        note_ticks(stack.enter_context(Record(folder / "ticks.npz", "began", "late", "work")))
        note_halts(stack.enter_context(Record(folder / "halts.npz", "at")))
        note_programs(stack.enter_context(Record(folder / "taken.npz", "at")))
        code = main(sys.argv[2:])
    sys.exit(code)
