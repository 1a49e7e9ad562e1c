"""Fuzzes the readers of wires and files, and the executor: python -m tests.fuzz [--inputs 20000] [READER ...].

Each reader has a process, two at a time. No input may end a reader, take long, or make it keep memory: otherwise the
exit code is 1, and the input is in the folder `fuzz-found`.
"""

from __future__ import annotations

import argparse
import gc
import signal
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings

from tests.fuzz.executor import Attack, lives
from tests.fuzz.readers import READERS, built, mutation
from tests.ros2.world.account import Wrong

PATIENCE = 5.0  # [s] of processor time for one input
WARM, LEAK = 0.2, 0.01  # share of the inputs before memory is looked at, and by which it may grow afterwards
KEPT = Path("fuzz-found")


class Endless(Exception):
    """One input took too long."""


def read(name: str, inputs: int) -> tuple[str, float, float, Counter[str]]:
    """Returns the processor time [s], the growth of the memory, and the number of failures of each kind."""
    take, wrong, before = built(name), Counter[str](), 0

    def interrupt(*_: Any) -> None:
        raise Endless(f"more than {PATIENCE:g} s for one input")

    signal.signal(signal.SIGVTALRM, interrupt)
    for number in range(inputs):
        key, data = mutation(name, number)
        signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE)
        try:
            take(key, data)
        except (Exception, Wrong) as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
            if not wrong[kind]:
                KEPT.mkdir(exist_ok=True)
                (KEPT / f"{name}-{number}").write_bytes(key.encode() + b"\n" + data)
                traceback.print_exc()
            wrong[kind] += 1
            take = built(name)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        if number == int(inputs * WARM):
            before = blocks()
    return name, time.process_time(), blocks() / before - 1, wrong


def blocks() -> int:
    """Returns the number of memory blocks that Python has allocated."""
    gc.collect()
    return sys.getallocatedblocks()


def attack(inputs: int) -> None:
    whole = Attack()
    quiet = settings(max_examples=inputs, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
    quiet(given(lives)(lambda acts: whole(acts)))()
    print(f"executor: {inputs:,} lives, {whole.switched:,} switches", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("readers", nargs="*", choices=(*READERS, []), help="by default all, and the executor")
    options = parser.parse_args()
    failed = False
    with ProcessPoolExecutor(2, max_tasks_per_child=1) as two:
        runs = [two.submit(read, name, options.inputs) for name in options.readers or READERS]
        rest = None if options.readers else two.submit(attack, options.inputs // 10)
        for run in runs:
            name, seconds, growth, wrong = run.result()
            print(
                f"{name}: {options.inputs:,} inputs, {seconds:.0f} s, memory {growth:+.2%}, {dict(wrong)}", flush=True
            )
            failed |= bool(wrong) or growth > LEAK
        if rest is not None:
            rest.result()
    raise SystemExit(failed)


if __name__ == "__main__":
    main()
