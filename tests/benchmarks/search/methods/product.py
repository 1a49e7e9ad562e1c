"""The product's own methods, through its Solver: the exact tail after pop and ipop-previous, and minimum-switch."""

from dataclasses import dataclass

from hyperbit.controller.bench.methods.planar import Array
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.search_time import TIMEOUT, SearchTime
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities


@dataclass(frozen=True, eq=False)
class Problem:
    solver: Solver
    method: Method
    deadline: float


def prepare(manipulator: Manipulator, densities: Densities, method: Method, deadline: float = TIMEOUT) -> Problem:
    solver = Solver(manipulator, densities)
    if method == "minimum-switch":
        solver.prepare()
    return Problem(solver, method, deadline)


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    return solution(problem, goal, previous, tolerance).configuration


def solution(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Solution:
    target, most = problem.solver.target(goal, tolerance), problem.deadline
    return problem.solver.solve(target, previous, problem.method, SearchTime(most, unfound=most))
