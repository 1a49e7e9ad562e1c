"""Adapters to the benchmark for methods that take positions of planar arms without obstacles."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.methods import (
    Solve,
    annealing,
    continuous,
    k_switch,
    paper_ipop,
    paper_pop,
    two_by_two,
    two_list,
)
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.manipulator.manipulator import Configuration


def suited(arm: BenchArm) -> BenchArm:
    """Returns the arm if these methods support it.

    Raises:
        NotImplementedError: the arm is spatial or has obstacles.
    """
    if not arm.model.manipulator.planar or arm.obstacles:
        raise NotImplementedError("planar arms without obstacles only")
    return arm


def solving(tables: Any, solve: Callable[[Any, Any, Configuration, float], Configuration]) -> Solve:
    """Returns `solve` of a method, see hyperbit.controller.bench.methods."""

    def solved(goal: Goal, start: Configuration) -> Configuration:
        if goal.orientation is not None or goal.tolerance is None:
            raise NotImplementedError("positions only")
        return solve(tables, np.array(goal.position, dtype=float), start, goal.tolerance)

    return solved


def meet_in_the_middle(arm: BenchArm) -> Solve:
    """Prepares plain meet in the middle."""
    return solving(two_list.prepare(suited(arm).model.manipulator, arm.densities), two_list.solve)


def pop_printed(arm: BenchArm) -> Solve:
    """Prepares POP as printed."""
    return solving(paper_pop.prepare(suited(arm).model.manipulator, arm.densities), paper_pop.solve)


def ipop_printed(arm: BenchArm) -> Solve:
    """Prepares IPOP as printed."""
    return solving(paper_ipop.prepare(suited(arm).model.manipulator, arm.densities), paper_ipop.solve)


def ipop_printed_switches(arm: BenchArm) -> Solve:
    """Prepares the variant that counts actuators."""
    return solving(paper_ipop.prepare(suited(arm).model.manipulator, arm.densities), paper_ipop.solve_by_switches)


def k_switch_3(arm: BenchArm) -> Solve:
    """Prepares the k-switch search."""
    return solving(k_switch.prepare(suited(arm).model.manipulator, None, switches=3), k_switch.solve)


def k_switch_4(arm: BenchArm) -> Solve:
    """Prepares the k-switch search."""
    return solving(k_switch.prepare(suited(arm).model.manipulator, None, switches=4), k_switch.solve)


def two_by_two_search(arm: BenchArm) -> Solve:
    """Prepares the two-by-two search."""
    return solving(two_by_two.prepare(suited(arm).model.manipulator, None), two_by_two.solve)


def annealing_10ms(arm: BenchArm) -> Solve:
    """Prepares simulated annealing."""
    return solving(annealing.prepare(suited(arm).model.manipulator, None, seconds=0.01), annealing.solve)


def rounding(arm: BenchArm) -> Solve:
    """Prepares rounding of a continuous solution."""
    try:
        return solving(continuous.prepare(suited(arm).model.manipulator, None), continuous.solve)
    except ValueError as error:
        raise NotImplementedError(str(error)) from None
