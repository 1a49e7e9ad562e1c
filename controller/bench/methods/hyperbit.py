"""hyperbit's own methods, called through its public library."""

from functools import partial
from typing import NamedTuple

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.methods import Solve
from hyperbit.controller.library.solver import Solver
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method


class OwnMethod(NamedTuple):
    method: Method

    def __call__(self, arm: BenchArm) -> Solve:
        return partial(Solver(arm.arm).solve, method=self.method)


minimum_switch = OwnMethod(MINIMUM_SWITCH)
ipop_previous = OwnMethod("ipop-previous")
ipop_contracted = OwnMethod("ipop-contracted")
ipop_fewest_switches = OwnMethod("ipop-fewest-switches")
ipop_fewest_extended = OwnMethod("ipop-fewest-extended")
pop = OwnMethod("pop")
