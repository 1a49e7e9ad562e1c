"""The methods of the benchmark, by name.

A method is a function `prepare(arm)`. It takes a hyperbit.controller.bench.arm.BenchArm and returns a function
`solve(goal, start)`. `solve` takes a hyperbit.Goal and a configuration, integers (B,). It returns a configuration, None
if it finds none, or an object with the attribute `configuration`. The benchmark also checks the object's `certificate`
("optimal", "unreachable") and `bound` (no valid configuration has fewer switches), if it has them. A method raises
NotImplementedError for an arm or a goal that it does not support.
"""

import importlib
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.controller.host.files import read_file
from hyperbit.controller.search.method import MINIMUM_SWITCH

if TYPE_CHECKING:
    from hyperbit.controller.bench.arm import BenchArm
    from hyperbit.controller.library.goals import Goal
    from hyperbit.controller.manipulator.manipulator import Configuration

Solve = Callable[["Goal", "Configuration"], Any]
Prepare = Callable[["BenchArm"], Solve]


class Entry(NamedTuple):
    """A method of the benchmark: its place, "module:function", and its description."""

    target: str
    summary: str


OWN, PLANAR = (f"hyperbit.controller.bench.methods.{module}" for module in ("hyperbit", "planar_positions"))
PRINTED = "re-implemented as printed (Ebert-Uphoff, Chirikjian 1996); planar positions"
FROM_K_SWITCH = "k-switch search, re-implemented from a description (Lees, Chirikjian 1996); planar positions"
FROM_TWO_BY_TWO = "re-implemented from a description (Motahari, Zohoor, Korayem 2013); planar positions"
METHODS = {
    MINIMUM_SWITCH: Entry(f"{OWN}:minimum_switch", "hyperbit's search for fewest switches"),
    "ipop-previous": Entry(
        f"{OWN}:ipop_previous", "hyperbit's IPOP, exact table; criterion: unchanged modules, as printed"
    ),
    "ipop-contracted": Entry(f"{OWN}:ipop_contracted", "the same; criterion: fully contracted modules, as printed"),
    "ipop-fewest-switches": Entry(
        f"{OWN}:ipop_fewest_switches", "variant of hyperbit's IPOP; criterion: fewest switches"
    ),
    "ipop-fewest-extended": Entry(
        f"{OWN}:ipop_fewest_extended", "variant of hyperbit's IPOP; criterion: fewest extended actuators"
    ),
    "pop": Entry(f"{OWN}:pop", "hyperbit's POP with its exact table"),
    "meet-in-the-middle": Entry(
        f"{PLANAR}:meet_in_the_middle", "two lists of half the arm, to 5 switches each; planar positions"
    ),
    "pop-printed": Entry(f"{PLANAR}:pop_printed", f"POP, {PRINTED}"),
    "ipop-printed": Entry(f"{PLANAR}:ipop_printed", f"IPOP, {PRINTED}"),
    "k-switch-3": Entry(f"{PLANAR}:k_switch_3", FROM_K_SWITCH),
    "k-switch-4": Entry(f"{PLANAR}:k_switch_4", "the same with k = 4"),
    "two-by-two": Entry(f"{PLANAR}:two_by_two_search", FROM_TWO_BY_TWO),
}


class FileMethod:
    """A method from a file. Pickled, it carries the source of the file, so workers do not need the file."""

    def __init__(self, path: str, function: str, source: bytes) -> None:
        self._sent = path, function, source
        self._prepare = function_of(lambda: executed(path, source), path, function)

    def __call__(self, arm: "BenchArm") -> Solve:
        return self._prepare(arm)

    def __reduce__(self) -> tuple[type["FileMethod"], tuple[str, str, bytes]]:
        return FileMethod, self._sent


def find_method(target: str) -> Prepare:
    """Imports the function of "module:function" or "file.py:function"; modules of the working directory are found.

    Raises ValueError: the text has another form, or the function cannot be imported.
    """
    place, _, name = target.rpartition(":")
    if not place or not name.isidentifier():
        raise ValueError(f"{target!r}: module:function or file.py:function is needed")
    if place.endswith(".py"):
        file = Path(place).absolute()
        try:
            source = read_file(file)
        except OSError as error:
            raise ValueError(f"{target!r}: {place} cannot be read: {error.strerror}") from error
        return FileMethod(str(file), name, source)
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    return function_of(lambda: importlib.import_module(place), place, name)


def function_of(load: Callable[[], ModuleType], place: str, name: str) -> Prepare:
    """Returns a function of the module that `load` returns. Raises ValueError if there is none."""
    try:
        module = load()
    except (Exception, SystemExit) as error:
        raise ValueError(f"{place} cannot be imported: {type(error).__name__}: {error}") from error
    found = getattr(module, name, None)
    if not callable(found):
        raise ValueError(f"{place} has no function {name!r}")
    return found  # type: ignore[no-any-return]


@lru_cache(maxsize=16)
def executed(path: str, source: bytes) -> ModuleType:
    """Returns the module of a file. Its name contains the file's path, so that it hides no other module."""
    module = ModuleType(path.replace(".", "_"))
    module.__file__ = path
    sys.modules[module.__name__] = module  # for dataclasses and pickle
    exec(compile(source, path, "exec"), vars(module))
    return module
