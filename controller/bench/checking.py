"""What an answer is worth: nothing that a method says of it is taken on trust."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from controller.bench.arm import BenchArm
from controller.bench.goal_sets import Task
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.notation import parse_configuration
from controller.search.solution import EPSILON
from controller.search.target import within


class Nonsense(Exception):
    """An answer is no configuration of the arm."""


@dataclass(frozen=True)
class Outcome:
    """What became of one goal.

    Attributes:
        solved: the answer is within the tolerances, and clear.
        switches: of the answer, counted anew; 0 if it is not solved.
        seconds: that the method took.
        proven: the method claims that the answer has the fewest switches, and nothing contradicts it.
        kind: why it is not solved: "missed", "touches", "nothing found" or what went wrong; empty if it is solved.
        detail: a sentence on that.
        wrong: a sentence on a certificate that is wrong; empty if none is.
        left_out: the method is not made for the goal.
    """

    solved: bool
    switches: int
    seconds: float
    proven: bool = False
    kind: str = ""
    detail: str = ""
    wrong: str = ""
    left_out: bool = False


def check(arm: BenchArm, task: Task, answer: Any, seconds: float) -> Outcome:
    """Returns what an answer is worth, by forward kinematics and recounted switches.

    Args:
        arm: the arm.
        task: its goal.
        answer: whatever the method returned.
        seconds: that it took.
    """
    try:
        given, certificate, bound = (attribute(answer, name) for name in ("configuration", "certificate", "bound"))
        if answer is None or (given is None and hasattr(answer, "configuration")):
            wrong = contradiction(task, False, 0, certificate, bound)
            return Outcome(False, 0, seconds, kind="nothing found", detail="returned None", wrong=wrong)
        own = configuration_of(answer if given is None else given, arm.model.manipulator)
    except Nonsense as error:
        return Outcome(False, 0, seconds, kind="no configuration", detail=str(error))
    kind, detail = fault(arm, task, own)
    switches = 0 if kind else arm.model.manipulator.switches(task.start, own)
    wrong = contradiction(task, not kind, switches, certificate, bound)
    proven = not kind and not wrong and certificate == "optimal"
    return Outcome(not kind, switches, seconds, proven, kind, detail, wrong)


def fault(arm: BenchArm, task: Task, configuration: Configuration) -> tuple[str, str]:
    """Returns why a configuration does not serve, as a word and a sentence; both are empty if it does."""
    tip = arm.model.manipulator.tip(configuration)
    if not within(tip, task.frame, task.tolerance, task.angle_tolerance):
        away = float(np.linalg.norm(tip[:3, 3] - task.frame[:3, 3]))
        return "missed", f"{away:.3g} away"
    where = arm.clearance.where(configuration)
    return ("", "") if where is None else ("touches", where)


def attribute(answer: Any, name: str) -> Any:
    """Returns an attribute of an answer, None if it has none.

    Raises:
        Nonsense: asking for it fails.
    """
    return guarded(lambda: getattr(answer, name, None))


def configuration_of(given: Any, manipulator: Manipulator) -> Configuration:
    """Returns an answer as a configuration (B,).

    Raises:
        Nonsense: it is none of the arm.
    """
    if isinstance(given, str):
        try:
            return parse_configuration(manipulator, given)
        except ValueError as error:
            raise Nonsense(str(error)) from None
    array = guarded(lambda: np.asarray(given))
    if array.shape != manipulator.states.shape or not np.issubdtype(array.dtype, np.integer):
        raise Nonsense(
            f"integers of shape {manipulator.states.shape} are needed, got {array.dtype} of shape {array.shape}"
        )
    if ((array < 0) | (array >= manipulator.states)).any():
        raise Nonsense(f"module {int(((array < 0) | (array >= manipulator.states)).argmax()) + 1} has no such state")
    return np.asarray(array, dtype=np.int64)


def guarded(ask: Callable[[], Any]) -> Any:
    """Returns what a question to a stranger's object brings.

    Raises:
        Nonsense: it raises.
    """
    try:
        return ask()
    except Exception as error:
        raise Nonsense(f"reading it raised {type(error).__name__}: {error}") from None


def contradiction(task: Task, solved: bool, switches: int, certificate: Any, bound: Any) -> str:
    """Returns what is wrong with a certificate, a sentence; empty if nothing is."""
    known = f"{task.switches} switches suffice"
    if certificate == "unreachable":
        return f"claims that the goal cannot be reached; {known}"
    if certificate == "optimal" and not solved:
        return f"claims that an answer is optimal that does not serve; {known}"
    if certificate == "optimal" and switches > task.switches:
        return f"claims that {switches} switches are the fewest; {known}"
    if bound is None:
        return ""
    if isinstance(bound, bool) or not isinstance(bound, (int, float, np.integer, np.floating)) or math.isnan(bound):
        return f"claims the bound {bound!r:.40}, which is no number"
    if bound > task.switches * (1 + EPSILON):
        return f"claims that no configuration has fewer than {bound:g} switches; {known}"
    return ""
