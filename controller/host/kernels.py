"""Compiles the kernels of the demo, the daemon and the library on all processors.

    python -m hyperbit.controller.host.kernels

numba compiles a kernel at its first call, and stores the machine code in its cache. A single process that compiles all
kernels takes minutes. Here a separate process compiles those of each module, after those that they call.
"""

import ast
import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyperbit.controller.host.kernel import Kernel

ROOTS = (
    *(f"hyperbit.controller.commands.operate.{name}" for name in ("demo", "run")),
    *(f"hyperbit.controller.library.{name}" for name in ("arm", "solver", "calibration")),
)
PACKAGE = Path(__file__).parents[2]


def imports(module: str) -> set[str]:
    """Returns the modules of the package that a module imports anywhere in its source."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source(module))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in found if name.startswith("hyperbit.controller.") and path(name).is_file()}


def path(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


def source(module: str) -> str:
    return path(module).read_text(encoding="utf-8")


def kernels(roots: tuple[str, ...] = ROOTS) -> dict[str, set[str]]:
    """Returns the modules with kernels that the roots import, each with its dependencies."""
    known: dict[str, set[str]] = {}

    def below(module: str) -> set[str]:
        if module not in known:
            known[module] = set()  # ends the recursion of circular imports
            known[module] = set().union(*({name, *below(name)} for name in imports(module)))
        return known[module]

    everything = set().union(*(below(root) for root in roots))
    compiled = {name for name in everything if "@kernel(" in source(name)}
    return {name: below(name) & compiled - {name} for name in compiled}


def compile_all(waiting: dict[str, set[str]], processes: int) -> None:
    """Imports modules in forked processes, each after its dependencies. Raises RuntimeError if one fails."""
    from numba import njit

    from hyperbit.controller.host.kernel import progress

    progress.silent = True
    # numba's own modules are loaded once here, and not in each process.
    njit("i8(i8)")(lambda x: x + 1)
    needed = {name: sum(name in others for others in waiting.values()) for name in waiting}
    waiting, running = dict(waiting), dict[int, str]()
    while waiting or running:
        unfinished = {*waiting, *running.values()}
        ready = [name for name, others in waiting.items() if not others & unfinished]
        if ready and len(running) < processes:
            name = max(ready, key=lambda name: (needed[name], name))
            del waiting[name]
            running[fork(name)] = name
            continue
        child, status = os.wait()
        if (name := running.pop(child)) and status != 0:
            raise RuntimeError(f"the kernels of {name} cannot be compiled")


def fork(module: str) -> int:
    if (child := os.fork()) != 0:
        return child
    status = 1
    try:
        importlib.import_module(module)
        for kernel in own_kernels(module):
            kernel.load()
        status = 0
    finally:
        if status:
            import traceback

            traceback.print_exc()
        os._exit(status)


def own_kernels(module: str) -> "list[Kernel]":
    from hyperbit.controller.host.kernel import kernels

    return [kernel for kernel in kernels if kernel.__module__ == module]


def drop_indexes() -> None:
    """Deletes numba's indexes of machine code: an index that names a moved module breaks the import."""
    for index in (PACKAGE / "controller").rglob("__pycache__/*.nbi"):
        index.unlink()


if __name__ == "__main__":
    drop_indexes()
    compile_all(kernels(), len(os.sched_getaffinity(0)))
