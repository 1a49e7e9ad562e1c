"""The outcome of a goal or jog as the executor ended it, and the payload of its result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.motion.targets import GoalTarget, measured_pose
from hyperbit.controller.planning.core.arm import Measured
from hyperbit.controller.planning.core.events import Payload
from hyperbit.controller.planning.core.reports import Context, GoalOutcome
from hyperbit.controller.program import Ended
from hyperbit.controller.refusals import codes

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

STATUS_CODES = {
    "canceled": codes.INVALID_GOAL,
    "replaced": codes.INVALID_GOAL,
    "aborted": codes.PATH_TOLERANCE_VIOLATED,
    "lost": codes.PATH_TOLERANCE_VIOLATED,
}


def outcome_of(manipulator: Manipulator, ended: Ended, measured: Measured, context: Context) -> GoalOutcome:
    """Returns the outcome of a program as the executor ended it, judged by the measured states (A,)."""
    if ended.status != "done":
        return GoalOutcome(ended.status, STATUS_CODES[ended.status], ended.message)
    if context.target is None:
        return jog_outcome(manipulator, measured, context)
    where = measured_pose(manipulator, measured, context.target)
    return last_waypoint_outcome(context.id, context.target, where)


def last_waypoint_outcome(goal: str, target: GoalTarget, where: Payload) -> GoalOutcome:
    """Returns the outcome of a goal whose last waypoint has settled; `where` is its measured_pose."""
    error, angle = where["error"], where["orientation_error"]
    if target.configuration is not None:
        reached = where["configuration"] == target.configuration
        measured = where["configuration"] or "unknown"
        message = f"the measured configuration is {measured}, not {target.configuration}"
    else:
        reached = error is not None and error <= target.tolerance
        reached = reached and (angle is None or angle <= target.angle_tolerance)
        away = "unknown" if error is None else f"{error:.4f} from the last waypoint"
        message = f"the measured tip is {away}, tolerance {target.tolerance:g}"
        if angle is not None:
            tolerances = f"tolerances {target.tolerance:g} and {target.angle_tolerance:g}"
            message = f"the measured tip is {away} and turned {angle:.4f} rad, {tolerances}"
    if reached:
        return GoalOutcome("succeeded", codes.SUCCESSFUL, "reached", f"holding; goal {goal} was reached")
    return GoalOutcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; goal {goal} was missed: {message}")


def why_not_as_planned(planned: PlanProof | None, improved: PlanProof | None, switches: int) -> str:
    """Returns why a goal needed more or fewer switches than its answer said; "" if it needed as many.

    `planned` is the plan when the goal was accepted; None for a jog. Nothing is known of `improved` if that is None.
    """
    if planned is None or planned.switches == switches:
        return ""
    if improved != planned:
        why = "the plan was improved while the arm moved"
    elif switches < planned.switches:
        why = "stages that were late were joined"
    else:
        why = "actuators that were not in their expected states were switched, too"
    return f"{switches} switches instead of {planned.switches}: {why}"


def jog_outcome(manipulator: Manipulator, measured: Measured, context: Context) -> GoalOutcome:
    """Returns whether the actuators of a jog are measured in their new states, as an outcome."""
    apart = [manipulator.actuators[k] for k, state in sorted(context.jogged.items()) if measured[k] != state]
    if not apart:
        return GoalOutcome("succeeded", codes.SUCCESSFUL, "switched", "holding; the actuators were switched")
    message = f"not measured in the requested state: {', '.join(apart)}"
    return GoalOutcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {message}")


def result_of(
    manipulator: Manipulator,
    ended: Ended,
    measured: Measured,
    context: Context,
    outcome: GoalOutcome,
    target: GoalTarget | None,
) -> Payload:
    """Returns the payload of a result.

    The certificate is that of the plan from where the goal began. It stands there only if the arm did exactly the
    switches that it speaks of; otherwise `certificate` is "unknown". Errors are given from `target`, if there is one.
    """
    proof, bias = context.proof, {} if context.bias is None else {"bias": context.bias}
    if context.jogged or not context.position:
        labels = manipulator.actuators
        travels = [
            {"actuator": labels[travel.actuator], "state": STATES[travel.state], "seconds": travel.seconds}
            for travel in ended.travels
        ]
        shown: Payload = {"travels": travels}
    else:
        as_planned = proof if outcome.status == "succeeded" and proof and proof.switches == ended.switches else None
        kind = "unknown" if as_planned is None else as_planned.certificate
        known = kind in ("optimal", "bound")
        shown = {
            "planned_switches": None if proof is None else proof.switches,
            "optimal": kind == "optimal" if known else None,
            "lower_bound": as_planned.bound if as_planned is not None and known else None,
            "certificate": kind,
        }
    return {
        "id": context.id,
        "status": outcome.status,
        "code": outcome.code,
        "message": outcome.message,
        "switches": ended.switches,
        **measured_pose(manipulator, measured, target),
        **bias,
        **shown,
    }
