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
    """Prepares IPOP, similarity to the previous configuration."""
    return solver(arm, "ipop-previous")


def ipop_contracted(arm: BenchArm) -> Solve:
    """Prepares IPOP, contracted actuators."""
    return solver(arm, "ipop-contracted")


def pop(arm: BenchArm) -> Solve:
    """Prepares POP."""
    return solver(arm, "pop")
