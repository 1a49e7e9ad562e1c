"""Plans goals without running them, and describes the plans."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from controller.manipulator.locked import transferred
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.notation import format_configuration, pose
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.plan import Plan
from controller.motion.whole import first_time, look_ahead
from controller.planning.core.events import done
from controller.planning.core.tasks import Described, DescribePlan
from controller.planning.workers.arm_model import ArmModel, Proceed
from controller.planning.workers.goal_plans import schedule_goal, search_plan


def describe(model: ArmModel, task: DescribePlan, proceed: Proceed, hurry: Callable[[], bool]) -> Described:
    """Returns the description of a plan.

    Args:
        model: of the arm.
        task: the goal.
        proceed: called between two parts of the planning.
        hurry: returns whether the search over the whole trajectory must end early.

    Raises:
        Refusal: there is no plan, or planning took too long.
        Abandoned: `proceed` has raised it.
    """
    until = time.monotonic() + task.seconds

    def in_time() -> None:
        proceed()
        if time.monotonic() > until:
            raise Refusal(INVALID_GOAL, f"planning took longer than {task.seconds:g} s: ask for fewer waypoints")

    trajectory = schedule_goal(model, task)
    plan, previous, solver = search_plan(model, task, trajectory, in_time, first_time(trajectory))
    if model.arm.settings.method == "minimum-switch":
        plan = look_ahead(solver, plan, previous, model.pace, stop=hurry)
    return Described(payload_of(model.arm.manipulator, solver.manipulator, previous, plan))


def payload_of(whole: Manipulator, reduced: Manipulator, previous: Configuration, plan: Plan) -> dict[str, Any]:
    """Returns the payload of a plan.

    Args:
        whole: the arm.
        reduced: the arm reduced by locked actuators; the plan's configurations are of this arm.
        previous: configuration before, shape (B,).
        plan: to describe.
    """
    trajectory = plan.trajectory
    before, stages = reduced.actuator_states(previous), list[list[list[str]]]()
    for transition in plan.transitions:
        changes = np.diff(np.vstack([before, transition.stages]).astype(int), axis=0)
        stages.append([[whole.actuators[a] for a in np.flatnonzero(c)] for c in changes if c.any()])
        before = transition.stages[-1]
    shift = np.zeros(trajectory.positions.shape[1]) if trajectory.bias is None else trajectory.bias
    points = [
        {
            "t": t,
            "goal": position if k in trajectory.fixed else position + shift,
            "between": trajectory.between(k),
            "configuration": format_configuration(whole, transferred(solution.configuration, reduced, whole)),
            **pose(whole, solution.tip),
            "error": solution.error,
            "orientation_error": solution.angle if trajectory.turns[k] < np.inf else None,
            "switches": solution.switches,
            "cost": solution.cost,
            **solution.proof(),
            "stages": labels,
            "excursion": transition.deviation,
            "seconds": solution.seconds,
        }
        for k, (t, position, solution, labels, transition) in enumerate(
            zip(trajectory.times, trajectory.positions, plan.solutions, stages, plan.transitions, strict=True)
        )
    ]
    between = len(points) - len(trajectory.waypoints)
    along = f", {between} points between them" if between else ""
    message = f"{len(trajectory.waypoints)} waypoints{along}, {plan.switches} switches"
    bias = {} if trajectory.bias is None else {"bias": trajectory.bias}
    proof = {"switches": plan.switches, "cost": plan.cost, **plan.proof()}
    return {**done(message), "waypoints": points, **proof, **bias}
