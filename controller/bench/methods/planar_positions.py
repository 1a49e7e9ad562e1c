"""Methods of the literature for positions of planar arms without obstacles, as methods of the benchmark."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.methods import Solve, k_switch, paper, two_by_two, two_list
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.manipulator.manipulator import Configuration


class PlanarMethod(NamedTuple):
    """A method with its tables, which need the densities if it is `mapped`."""

    prepare: Callable[..., Any]
    solve: Callable[..., Configuration]
    mapped: bool = False

    def __call__(self, arm: BenchArm) -> Solve:
        if not arm.model.manipulator.planar or arm.obstacles:
            raise NotImplementedError("planar arms without obstacles only")
        tables = self.prepare(arm.model.manipulator, arm.densities if self.mapped else None)

        def solve(goal: Goal, start: Configuration) -> Configuration:
            if goal.orientation is not None or goal.tolerance is None:
                raise NotImplementedError("positions only")
            return self.solve(tables, np.array(goal.position, dtype=float), start, goal.tolerance)

        return solve


meet_in_the_middle = PlanarMethod(two_list.prepare, two_list.solve, mapped=True)
pop_printed = PlanarMethod(paper.prepare, paper.solve_pop, mapped=True)
ipop_printed = PlanarMethod(paper.prepare, paper.solve_ipop, mapped=True)
k_switch_3 = PlanarMethod(partial(k_switch.prepare, switches=3), k_switch.solve)
k_switch_4 = PlanarMethod(partial(k_switch.prepare, switches=4), k_switch.solve)
two_by_two_search = PlanarMethod(two_by_two.prepare, two_by_two.solve)
