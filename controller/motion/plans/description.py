"""Descriptions of plans and solutions, as fields for JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET

from hyperbit.controller.manipulator.locked import transferred
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.messages.goals import Plan, PlanPoint

if TYPE_CHECKING:  # their kernels take seconds to import
    from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
    from hyperbit.controller.motion.plans.plan import TrajectoryPlan
    from hyperbit.controller.motion.stages.pacing import Pace, Staged
    from hyperbit.controller.search.solution import Solution


def describe_solution(whole: Manipulator, reduced: Manipulator, solution: Solution, oriented: bool) -> dict[str, Any]:
    """Returns the fields of one solution, of the arm reduced by locked actuators; `oriented`: the goal is a pose."""
    return {
        "configuration": format_configuration(whole, transferred(solution.configuration, reduced, whole)),
        **pose(whole, solution.tip),
        "error": solution.error,
        "orientation_error": solution.angle if oriented else None,
        "switches": solution.switches,
        **({"seconds": solution.seconds} if solution.effort is None else {"effort": solution.effort}),
        "cost": solution.cost,
        **solution.proof(),
    }


def describe_plan(
    whole: Manipulator, reduced: Manipulator, previous: Configuration, plan: TrajectoryPlan, pace: Pace
) -> Plan:
    """Returns a plan as the answer to `plan`.

    The plan is of the arm reduced by locked actuators, from the configuration `previous` (B,).
    """
    trajectory, before = plan.trajectory, reduced.actuator_states(previous)
    shift = np.zeros(trajectory.positions.shape[1]) if trajectory.bias is None else trajectory.bias
    points = list[PlanPoint]()
    for k, (solution, transition) in enumerate(zip(plan.solutions, plan.transitions, strict=True)):
        changes = np.diff(np.vstack([before, transition.stages]).astype(int), axis=0)
        before, position = transition.stages[-1], trajectory.positions[k]
        points.append(
            PlanPoint(
                t=float(trajectory.times[k]),
                goal=(position if k in trajectory.fixed else position + shift).tolist(),
                between=trajectory.between(k),
                **describe_solution(whole, reduced, solution, bool(trajectory.turns[k] < np.inf)),
                stages=[[whole.actuators[a] for a in np.flatnonzero(c)] for c in changes if c.any()],
                needed=needed(pace, solution, transition),
                excursion=transition.deviation,
            )
        )
    between = len(points) - len(trajectory.waypoints)
    along = f", {between} points between them" if between else ""
    return Plan(
        accepted=True,
        message=f"{len(trajectory.waypoints)} waypoints{along}, {plan.switches} switches",
        waypoints=points,
        switches=plan.switches,
        cost=plan.cost,
        **plan.proof(),
        bias=UNSET if trajectory.bias is None else trajectory.bias.tolist(),
    )


def needed(pace: Pace, solution: Solution, transition: Staged) -> float:
    """Returns the least time for a transition [s]: stages among obstacles stay as they are, others may be merged."""
    if solution.switches == 0:
        return 0.0
    return pace.rest + pace.lead * len(transition.stages) if transition.strict else pace.needed(solution.switches)
