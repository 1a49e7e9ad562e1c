"""Measurement of methods: one process, one thread, loaded kernels, no garbage collection during the measurement."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities
from tests.benchmarks.harness import no_collection, timed
from tests.benchmarks.search.methods import MEETING, OPTIMUM, Method, product
from tests.benchmarks.solving import WARM, home

Goals = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    manipulator: Manipulator
    densities: Densities
    mapping: float
    tolerance: float

    @property
    def home(self) -> Configuration:
        return home(self.manipulator)

    def error(self, configuration: Configuration, goal: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(self.manipulator.tip(configuration)[:2, 3] - goal))


@dataclass(frozen=True, eq=False)
class Trace:
    """Switches, errors and times of one method for each goal, each of shape (n,)."""

    switches: NDArray[np.int64]
    errors: NDArray[np.float64]
    seconds: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proofs:
    """The first goals of a set, each from the configuration of fewest switches for the goal before.

    Attributes:
        previous: configurations, shape (n, B).
        fewest: switches from there to the goal, shape (n,); -1 where the time did not suffice for the proof.
    """

    previous: NDArray[np.int64]
    fewest: NDArray[np.int64]
    trace: Trace


def prepared(method: Method, arm: Arm) -> tuple[Any, float, int]:
    """Returns a method's problem, and time [s] and memory [bytes] of its tables."""
    problem, seconds = timed(lambda: method.prepare(arm.manipulator, arm.densities))
    return problem, seconds + (arm.mapping if method.mapped else 0.0), memory(problem)


def traced(method: Method, problem: Any, arm: Arm, goals: Goals, previous: NDArray[np.int64] | None = None) -> Trace:
    """Solves goals in sequence, each from the previous goal's configuration, or from given ones (n, B)."""
    for goal in goals[:WARM]:
        method.solve(problem, goal, arm.home, arm.tolerance)
    own, switches, errors, seconds = arm.home, [], [], []
    with no_collection():
        for n, goal in enumerate(goals):
            before = own if previous is None else previous[n]
            began = time.perf_counter()
            own = method.solve(problem, goal, before, arm.tolerance)
            seconds.append(time.perf_counter() - began)
            switches.append(arm.manipulator.switches(own, before))
            errors.append(arm.error(own, goal))
    return Trace(np.array(switches), np.array(errors), np.array(seconds))


def proven(problem: Any, arm: Arm, goals: Goals, most: float) -> Proofs:
    """Proves the minimum of switches for as many goals as possible in `most` seconds."""
    second = MEETING.prepare(arm.manipulator, arm.densities)
    for goal in goals[:WARM]:
        OPTIMUM.solve(problem, goal, arm.home, arm.tolerance)
    own, previous, fewest, errors, seconds = arm.home, [], [], [], []
    with no_collection():
        for goal in goals:
            previous.append(own)
            began = time.perf_counter()
            found = OPTIMUM.solve(problem, goal, own, arm.tolerance)
            seconds.append(time.perf_counter() - began)
            fewest.append(-1 if found is None else arm.manipulator.switches(found, own))
            own = MEETING.solve(second, goal, own, arm.tolerance) if found is None else found
            errors.append(arm.error(own, goal))
            if sum(seconds) > most:
                break
    number = np.array(fewest)
    return Proofs(np.array(previous), number, Trace(number, np.array(errors), np.array(seconds)))


def ratio(method: Method, problem: Any, arm: Arm, goals: Goals, proofs: Proofs) -> tuple[float | None, int]:
    """Returns the ratio of switches to the proven minimum, from the same configurations, and the number of goals.

    Only goals with a proven optimum that the method solves are counted.
    """
    number = len(proofs.fewest)
    trace = traced(method, problem, arm, goals[:number], proofs.previous)
    fewest = proofs.fewest[:number]
    counts = (fewest >= 0) & (trace.errors <= arm.tolerance)
    if np.any(trace.switches[counts] < fewest[counts]):
        raise AssertionError(f"{method.name} needs fewer switches than were proven to be the fewest")
    total = fewest[counts].sum()
    return (float(trace.switches[counts].sum() / total) if total else None), int(counts.sum())


def claimed(problem: product.Problem, arm: Arm, goals: Goals, proofs: Proofs) -> tuple[int, int, int]:
    """Returns the numbers of answers that the product claims to be optimal: all, confirmed, and refuted."""
    claims = agrees = contradicts = 0
    for goal, before, fewest in zip(goals, proofs.previous, proofs.fewest, strict=False):
        solution = product.solution(problem, goal, before, arm.tolerance)
        claims += solution.certificate == "optimal"
        if solution.optimal and fewest >= 0:
            agrees += solution.switches == fewest
            contradicts += solution.switches != fewest
        elif fewest >= 0:
            contradicts += solution.bound > fewest
    return claims, agrees, contradicts


def memory(thing: Any, seen: set[int] | None = None) -> int:
    """Returns the bytes of all arrays that a problem holds, each once."""
    seen = set() if seen is None else seen
    if id(thing) in seen or isinstance(thing, (str, type)):
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return memory(thing.base, seen) if isinstance(thing.base, np.ndarray) else thing.nbytes
    if isinstance(thing, dict):
        return sum(memory(value, seen) for value in thing.values())
    if isinstance(thing, (list, tuple)):
        return sum(memory(value, seen) for value in thing)
    return memory(vars(thing), seen) if hasattr(thing, "__dict__") else 0


def exponent(modules: list[int], values: list[float]) -> float:
    return float(np.polyfit(np.log(modules), np.log(values), 1)[0])
