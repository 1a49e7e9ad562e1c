"""The compared methods. A method is a file with `prepare(manipulator, densities, ...)`, which returns its problem
(tables), and `solve(problem, goal, previous, tolerance)`, which returns a configuration.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from hyperbit.controller.bench.methods import k_switch, paper, two_by_two, two_list
from hyperbit.controller.search.method import METHODS as PRODUCT_METHODS
from tests.benchmarks.search.methods import optimum, product


@dataclass(frozen=True)
class Method:
    """One method.

    Attributes:
        mapped: whether the densities are among its tables.
    """

    name: str
    prepare: Callable[..., Any]
    solve: Callable[..., Any]
    mapped: bool = False


OURS = "minimum-switch"

OPTIMUM = Method("proven optimum", optimum.prepare, optimum.solve)
MEETING = Method("meet in the middle", two_list.prepare, two_list.solve, mapped=True)
METHODS = (
    *(
        Method(f"hyperbit {name}", partial(product.prepare, method=name), product.solve, mapped=True)
        for name in (OURS, "ipop-fewest-switches", "ipop-previous", "ipop-contracted", "pop")
        if name in PRODUCT_METHODS
    ),
    MEETING,
    Method("POP, as printed", paper.prepare, paper.solve_pop, mapped=True),
    Method("IPOP, as printed", paper.prepare, paper.solve_ipop, mapped=True),
    Method("two-by-two", two_by_two.prepare, two_by_two.solve),
    Method("k-switch, k = 3", partial(k_switch.prepare, switches=3), k_switch.solve),
    Method("k-switch, k = 4", partial(k_switch.prepare, switches=4), k_switch.solve),
)
