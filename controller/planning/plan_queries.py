"""Answers `plan` queries in a thread with a solver of its own, so that goals never wait for them."""

import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controller.manipulator.locked import transferred
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.notation import format_configuration, pose
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import GoalMessage
from controller.motion.plan import Plan
from controller.motion.whole import first_time, look_ahead
from controller.planning.goal_planning import GoalPlanning
from controller.planning.messages import CLOSING, Payload, Reply, done
from controller.planning.request_queue import RequestQueue

MOST_WAITING = 4
DEADLINE = 10.0  # [s] for one query, without its time in the queue


@dataclass(frozen=True, eq=False)
class PlanQuery:
    """A goal to plan but not to run; `received` is the time of arrival [UNIX s]."""

    reply: Reply
    message: GoalMessage
    received: float
    goal: str | None


class PlanQueries:
    """Answers each query once.

    Attributes:
        requests: the waiting queries.

    Args:
        planning: makes the plans; not shared.
        busy: returns whether a goal waits to be planned; the search over the whole trajectory then ends early.
    """

    def __init__(self, planning: GoalPlanning, busy: Callable[[], bool]) -> None:
        self._planning, self._busy = planning, busy
        self.requests = RequestQueue("plan queries", MOST_WAITING, self._serve)

    def submit(self, payload: bytes, reply: Reply) -> None:
        """Queues a query, or refuses it at once. Never waits."""
        self.requests.submit(lambda: self._query(payload, reply), reply)

    def _query(self, payload: bytes, reply: Reply) -> PlanQuery:
        """Decodes a query.

        Raises:
            Refusal: the query is malformed, or far out of reach.
        """
        message = self._planning.read(payload)
        return PlanQuery(reply, message, time.time(), message.id or uuid.uuid4().hex[:12])

    def _serve(self, query: PlanQuery) -> None:
        until = time.monotonic() + DEADLINE

        def proceed() -> None:
            if self.requests.closing:
                raise Refusal(codes.INVALID_GOAL, CLOSING)
            if time.monotonic() > until:
                raise Refusal(codes.INVALID_GOAL, f"planning took longer than {DEADLINE:g} s: ask for fewer waypoints")

        def hurry() -> bool:
            return self.requests.closing or self._busy() or self.requests.waiting() > 0

        trajectory = self._planning.trajectory(query.message, query.received)
        found = self._planning.plan(trajectory, proceed, run=False, seconds=first_time(trajectory))
        plan = found.plan
        if self._planning.arm.settings.method == "minimum-switch":
            plan = look_ahead(found.solver, plan, found.previous, self._planning.pace, stop=hurry)
        reduced = found.solver.manipulator
        query.reply(described(self._planning.arm.manipulator, reduced, found.previous, plan))


def described(whole: Manipulator, reduced: Manipulator, previous: Configuration, plan: Plan) -> Payload:
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
