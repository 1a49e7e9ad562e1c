"""The unmodified `hyperbit run`, in a process that also records the times of goals, searches and programs.

python -m tests.benchmarks.daemon.chain.planner RECORDS ARM.yaml --socket PATH --listen ENDPOINT --ledger PATH. RECORDS
is a folder of files with one row for each event. goals.npz has the goals that came in, services.npz their planning, and
solves.npz the searches. programs.npz has the programs, from before they are packed until they are sent.
"""

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from hyperbit.controller.planning.link import ExecutorLink
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.program import Down, Program
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.daemon.chain.records import Record
from tests.system.stack.nursery import run


def timed(owner: type, name: str, record: Record, takes: Callable[..., bool] = lambda *_: True) -> None:
    """Records begin and end of the calls of a method [s]."""
    method = getattr(owner, name)

    def timing(*arguments: Any, **options: Any) -> Any:
        began = time.monotonic()
        try:
            return method(*arguments, **options)
        finally:
            if takes(*arguments[1:]):
                record.note(began, time.monotonic())

    setattr(owner, name, timing)


def is_goal(key: str, payload: bytes) -> bool:
    return key == "goal"


def is_program(message: Down) -> bool:
    return isinstance(message, Program)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    with ExitStack() as stack:
        goals, services, solves, programs = (
            stack.enter_context(Record(folder / f"{name}.npz", "began", "ended"))
            for name in ("goals", "services", "solves", "programs")
        )
        timed(RequestDecoder, "decode", goals, is_goal)
        timed(computations, "plan_goal", services)  # type: ignore[arg-type]
        timed(Solver, "solve", solves)
        timed(ExecutorLink, "send", programs, is_program)
        code = 0
        try:
            code = run(sys.argv[2:])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    sys.exit(code)
