"""hyperbit's own methods, by its library, as anybody's program would use them."""

from functools import partial

from controller.bench.arm import BenchArm
from controller.bench.methods import Solve
from controller.library.solver import Solver
from controller.search.method import Method


def solver(arm: BenchArm, method: Method) -> Solve:
    """Returns what solves a goal by one of the library's methods."""
    return partial(Solver(arm.arm).solve, method=method)


def minimum_switch(arm: BenchArm) -> Solve:
    """Prepares the search for fewest switches."""
    return solver(arm, "minimum-switch")


def ipop_previous(arm: BenchArm) -> Solve:
    """Prepares IPOP, modules that remain in their state."""
    return solver(arm, "ipop-previous")


def ipop_contracted(arm: BenchArm) -> Solve:
    """Prepares IPOP, modules that are fully contracted."""
    return solver(arm, "ipop-contracted")


def ipop_fewest_switches(arm: BenchArm) -> Solve:
    """Prepares IPOP, actuators that switch."""
    return solver(arm, "ipop-fewest-switches")


def ipop_fewest_extended(arm: BenchArm) -> Solve:
    """Prepares IPOP, actuators that are extended."""
    return solver(arm, "ipop-fewest-extended")


def pop(arm: BenchArm) -> Solve:
    """Prepares POP."""
    return solver(arm, "pop")
