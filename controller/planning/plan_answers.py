"""The payload that answers a `plan` query: what a goal would do at each point."""

import numpy as np

from controller.manipulator.held import carried
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.notation import format_configuration, pose
from controller.motion.plan import Plan
from controller.planning.messages import Payload, done


def described(whole: Manipulator, reduced: Manipulator, previous: Configuration, plan: Plan) -> Payload:
    """Returns the payload of a plan.

    Args:
        whole: the arm.
        reduced: the arm without the states that locked actuators rule out; configurations of the plan are its own.
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
            "configuration": format_configuration(whole, carried(solution.configuration, reduced, whole)),
            **pose(whole, solution.tip),
            "error": solution.error,
            "orientation_error": solution.angle if trajectory.turns[k] < np.inf else None,
            "switches": solution.switches,
            "stages": labels,
            "excursion": transition.excursion,
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
    return {**done(message), "waypoints": points, "switches": plan.switches, **bias}
