"""Compiles the kernels of the tests and of `hyperbit bench` on all processors: python -m tests.kernels.

`make test` runs it before the tests: otherwise each of its processes compiles these kernels, which takes a minute.
"""

import os
from pathlib import Path

from hyperbit.controller.host.kernels import compile_all, imports, source

ROOT = Path(__file__).parents[1]
TESTS = {"tests.benchmarks.proofs.kernels": set[str]()}  # modules whose import compiles kernels, with what they need


def bench() -> dict[str, set[str]]:
    """Returns the methods of `hyperbit bench` with kernels, each with those that it depends on."""
    names = [
        f"hyperbit.controller.bench.methods.{path.stem}"
        for path in (ROOT / "controller/bench/methods").glob("[!_]*.py")
    ]
    own = {name for name in names if "@kernel(" in source(name)}
    return {name: imports(name) & own for name in own}


if __name__ == "__main__":
    compile_all(bench() | TESTS, len(os.sched_getaffinity(0)))
