"""hyperbit's own methods, called through its public library."""

from functools import partial

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.methods import Solve
from hyperbit.controller.library.solver import Solver
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method


def solver(arm: BenchArm, method: Method) -> Solve:
    """Returns `solve` of one of the library's methods."""
    return partial(Solver(arm.arm).solve, method=method)


def minimum_switch(arm: BenchArm) -> Solve:
    """Prepares the search for fewest switches."""
    return solver(arm, MINIMUM_SWITCH)


def ipop_previous(arm: BenchArm) -> Solve:
    """Prepares IPOP with the criterion of unchanged modules."""
    return solver(arm, "ipop-previous")


def ipop_contracted(arm: BenchArm) -> Solve:
    """Prepares IPOP with the criterion of fully contracted modules."""
    return solver(arm, "ipop-contracted")


def ipop_fewest_switches(arm: BenchArm) -> Solve:
    """Prepares IPOP with the criterion of fewest switches."""
    return solver(arm, "ipop-fewest-switches")


def ipop_fewest_extended(arm: BenchArm) -> Solve:
    """Prepares IPOP with the criterion of fewest extended actuators."""
    return solver(arm, "ipop-fewest-extended")


def pop(arm: BenchArm) -> Solve:
    """Prepares POP."""
    return solver(arm, "pop")
