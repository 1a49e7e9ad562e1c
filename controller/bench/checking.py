"""Checks an answer by forward kinematics and recounted switches; trusts no claim of the method."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.goal_sets import Task
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.search.solution import EPSILON
from hyperbit.controller.search.target import within


class InvalidAnswer(Exception):
    """An answer is no configuration of the arm."""


@dataclass(frozen=True)
class Outcome:
    solved: bool  # whether the answer is within the tolerances and collision-free
    switches: int  # recounted, of the answer; 0 if it is not solved
    seconds: float  # time of the method
    proven: bool = False  # whether the method claims optimality and the certified optimum agrees
    kind: str = ""  # why it is not solved: "missed", "touches", "nothing found" or a kind of error; empty if solved
    detail: str = ""  # a sentence on `kind`
    wrong: str = ""  # a sentence on a wrong certificate; empty if there is none
    left_out: bool = False  # whether the method does not support the goal


def check(arm: BenchArm, task: Task, answer: Any, seconds: float) -> Outcome:
    """Checks an answer, of any type, which a method gave in `seconds`."""
    try:
        names = "configuration", "certificate", "bound"
        given, certificate, bound = evaluated(lambda: [getattr(answer, name, None) for name in names])
        if answer is None or (given is None and hasattr(answer, "configuration")):
            wrong = contradiction(task, False, 0, certificate, bound)
            return Outcome(False, 0, seconds, kind="nothing found", detail="returned None", wrong=wrong)
        own = configuration_of(answer if given is None else given, arm.model.manipulator)
    except InvalidAnswer as error:
        return Outcome(False, 0, seconds, kind="no configuration", detail=str(error))
    kind, detail = fault(arm, task, own)
    switches = 0 if kind else arm.model.manipulator.switches(task.start, own)
    wrong = contradiction(task, not kind, switches, certificate, bound)
    proven = not kind and not wrong and certificate == "optimal"
    return Outcome(not kind, switches, seconds, proven, kind, detail, wrong)


def fault(arm: BenchArm, task: Task, configuration: Configuration) -> tuple[str, str]:
    """Returns why a configuration does not solve a goal, as a kind and a sentence; both are empty if it does."""
    tip = arm.model.manipulator.tip(configuration)
    if not within(tip, task.frame, task.tolerance, task.angle_tolerance):
        away = float(np.linalg.norm(tip[:3, 3] - task.frame[:3, 3]))
        return "missed", f"{away:.3g} away"
    where = arm.clearance.where(configuration)
    return ("", "") if where is None else ("touches", where)


def configuration_of(given: Any, manipulator: Manipulator) -> Configuration:
    """Returns an answer as a configuration (B,); raises InvalidAnswer if it is none of the arm."""
    if isinstance(given, str):
        try:
            return parse_configuration(manipulator, given)
        except ValueError as error:
            raise InvalidAnswer(str(error)) from None
    array = evaluated(lambda: np.asarray(given))
    if array.shape != manipulator.states.shape or not np.issubdtype(array.dtype, np.integer):
        raise InvalidAnswer(
            f"integers of shape {manipulator.states.shape} are needed, got {array.dtype} of shape {array.shape}"
        )
    if (wrong := (array < 0) | (array >= manipulator.states)).any():
        raise InvalidAnswer(f"module {int(wrong.argmax()) + 1} has no such state")
    return np.asarray(array, dtype=np.int64)


def evaluated(call: Callable[[], Any]) -> Any:
    """Calls a function on an object of a method; an exception becomes InvalidAnswer."""
    try:
        return call()
    except Exception as error:
        raise InvalidAnswer(f"reading it raised {type(error).__name__}: {error}") from None


def contradiction(task: Task, solved: bool, switches: int, certificate: Any, bound: Any) -> str:
    """Returns a sentence on a wrong certificate; empty if the certified optimum does not contradict it."""
    known = f"{task.switches} switches suffice"
    if certificate == "unreachable":
        return f"claims that the goal cannot be reached; {known}"
    if certificate == "optimal" and not solved:
        return f"claims optimality of an answer that does not solve the goal; {known}"
    if certificate == "optimal" and switches > task.switches:
        return f"claims that {switches} switches are the fewest; {known}"
    if bound is None:
        return ""
    if isinstance(bound, bool) or not isinstance(bound, (int, float, np.integer, np.floating)) or math.isnan(bound):
        return f"claims the bound {bound!r:.40}, which is no number"
    if bound > task.switches * (1 + EPSILON):
        return f"claims that no configuration has fewer than {bound:g} switches; {known}"
    return ""
