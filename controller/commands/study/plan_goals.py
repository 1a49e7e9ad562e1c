"""Searches for the goals of `plan`: for each goal separately, or for all goals as one trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controller.arm.arm import Arm
from controller.commands.common import Failed, errors
from controller.manipulator import frames
from controller.manipulator.manipulator import Configuration
from controller.motion.codes import Refusal
from controller.search.method import Method

if TYPE_CHECKING:  # the search's kernels take a second to import
    from controller.motion.plans.whole import TipGoals
    from controller.search.solution import Solution
    from controller.search.solver import Solver

Orientation = float | list[float] | None
Goals = list[tuple[list[float], Orientation, Configuration | None]]


class Tolerances(NamedTuple):
    """Tolerances of all goals.

    Attributes:
        position: greatest distance of the tip from a goal.
        angle: greatest angle from a goal's orientation [rad].
        path: follow straight lines between goals within this distance; None: do not.
    """

    position: float
    angle: float
    path: float | None = None


class Answer(NamedTuple):
    """The solution of a goal, or of a point between two goals.

    Attributes:
        position: of the goal, shape (dimension,).
        orientation: of the goal, an angle [rad] or a quaternion; None: any orientation.
        solution: configuration, tip and certificate.
        between: whether the point lies on a line between goals.
        whole: switches, cost and certificate of the whole trajectory, for JSON; None: a separate search.
    """

    position: list[float]
    orientation: Orientation
    solution: Solution
    between: bool = False
    whole: dict[str, Any] | None = None


Answers = Iterator[Answer]


def search(solver: Solver, wanted: Goals, start: Configuration, tolerances: Tolerances, method: Method) -> Answers:
    """Yields the solution of each goal, searched separately.

    Each search starts at the previous solution, or at the goal's own previous configuration.
    """
    for position, orientation, given in wanted:
        goal = np.array(position) if orientation is None else frame(position, orientation)
        own, angle = start if given is None else given, np.inf if orientation is None else tolerances.angle
        found = solver.solve(solver.target(goal, tolerances.position, angle), own, method)
        start = found.configuration
        yield Answer(position, orientation, found)


def given(solver: Solver, configuration: Configuration, start: Configuration, tolerance: float) -> Answer:
    """Returns a configuration as the solution of its own tip position, without a search."""
    position = solver.manipulator.tip(configuration)[: solver.manipulator.dimension, 3]
    return Answer(position.tolist(), None, solver.described(configuration, solver.target(position, tolerance), start))


def frame(position: list[float], orientation: float | list[float]) -> frames.Frame:
    """Returns the tip's frame (4, 4) of a goal."""
    if isinstance(orientation, float):
        return frames.planar(position[0], position[1], orientation)
    return frames.spatial(position, orientation)


def follow(
    arm: Arm,
    solver: Solver,
    wanted: Goals,
    start: Configuration,
    tolerances: Tolerances,
    method: Method,
) -> Answers:
    """Yields the solution of each point of a trajectory, as the daemon answers `plan`.

    The trajectory leaves enough time for all switches. A goal with a previous configuration begins a new trajectory.
    Goals that cannot be planned as one trajectory are searched separately.

    Args:
        arm: the arm.
        solver: solver of the reduced arm.
        wanted: the goals.
        start: configuration before the first goal, shape (B,).
        tolerances: of all goals.
        method: search method.

    Raises:
        Failed: the lines between the goals cannot be followed.
    """
    from controller.motion.plans.transitions import TransitionPlanner
    from controller.motion.plans.whole import plan_whole, unhurried
    from controller.motion.stages.pacing import pace_of

    pace = pace_of(arm.settings)
    begins = [k for k, (_, _, given) in enumerate(wanted) if k == 0 or given is not None]
    for first, end in zip(begins, [*begins[1:], len(wanted)], strict=True):
        part, before = wanted[first:end], wanted[first][2]
        start = start if before is None else before
        try:
            trajectory = unhurried(as_arrays(part, tolerances), pace, tolerances.path)
            found = plan_whole(TransitionPlanner(solver, trajectory, pace), start, method)
        except Refusal as refusal:
            if tolerances.path is not None:
                raise Failed(str(refusal)) from None
            errors.print(f"no plan of the whole trajectory: {refusal}; each goal is searched separately")
            for answer in search(solver, [(p, o, None) for p, o, _ in part], start, tolerances, method):
                start = answer.solution.configuration
                yield answer
            continue
        whole = {"switches": found.switches, "cost": found.cost, **found.proof()}
        for k, solution in enumerate(found.solutions):
            between = trajectory.between(k)
            position, orientation, _ = part[trajectory.next(k)]
            if between:
                position = trajectory.positions[k].tolist()
            yield Answer(position, orientation, solution, between, whole)
        start = found.solutions[-1].configuration


def as_arrays(wanted: Goals, tolerances: Tolerances) -> TipGoals:
    """Returns goals as arrays with their tolerances; the orientation tolerance is infinite without an orientation."""
    from controller.motion.plans.whole import TipGoals

    turns = np.array([np.inf if orientation is None else tolerances.angle for _, orientation, _ in wanted])
    rotations = [np.eye(3) if o is None else frame(p, o)[:3, :3] for p, o, _ in wanted]
    positions = np.array([position for position, _, _ in wanted], dtype=np.float64)
    return TipGoals(positions, np.full(len(wanted), tolerances.position), np.array(rotations), turns)
