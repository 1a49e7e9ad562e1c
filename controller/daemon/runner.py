"""Goals on the boards: one at a time, each told its result exactly once; or a moving goal, which is followed."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from controller.daemon.avoidance import Avoidance, Kept, Unknown
from controller.daemon.events import Follow, Judged, Payload, Planned
from controller.daemon.execution import Execution, start
from controller.daemon.ledger import Ledger
from controller.daemon.switching import States, Switching, Touching
from controller.daemon.verdict import UNKNOWN, at_the_end, bias, feedback, on_the_way, whereabouts
from controller.manipulator.manipulator import Manipulator
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.pacing import Pace, Staged
from controller.motion.plan import Plan
from drivers.boards import Boards

log = logging.getLogger(__name__)


class Runner:
    """Switches the boards to the points of the running goal. The control loop's, called by no other thread.

    Attributes:
        switching: of the boards.
        execution: of the running goal.
        following: what a moving goal asks for; there is never both.

    Args:
        manipulator: the arm.
        boards: connected.
        travel: longest time of an actuator from end-stop to end-stop [s].
        pace: of the transitions.
        publish: sends a payload on "feedback" or "result"; must not wait.
        ledger: counts switches and goals.
        avoidance: tells what is to be kept clear of.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        boards: Boards,
        travel: float,
        pace: Pace,
        publish: Callable[[str, Payload], None],
        ledger: Ledger,
        avoidance: Avoidance,
    ) -> None:
        self.switching = Switching(manipulator, boards, travel, pace, ledger, avoidance)
        self.execution: Execution | None = None
        self.following: Follow | None = None
        self._manipulator, self._boards, self._travel, self._lead = manipulator, boards, travel, pace.lead
        self._publish, self._ledger, self._avoidance = publish, ledger, avoidance
        self._accepted = 0
        self._now, self._waits = 0.0, False

    @property
    def waits(self) -> int:
        """In how many periods something waited until it was known to touch nothing."""
        return self._avoidance.waits

    def first(self, goal: Planned) -> States:
        """Returns the stages (k, A) with which a goal may begin now, from the states as they are.

        Raises:
            Refusal: it may not.
            Unknown: it may if they touch nothing, which is not known yet.
        """
        trajectory, kept = goal.plan.trajectory, self._avoidance.kept
        late = 0.0 if trajectory.stamp is None else time.time() - trajectory.stamp - float(trajectory.times[-1])
        if late > 0:
            raise Refusal(codes.OLD_HEADER_TIMESTAMP, f"stamp: the trajectory ended {late:.3f} s before it was planned")
        if self.execution is not None and self.execution.goal.id == goal.id:
            raise Refusal(
                codes.INVALID_GOAL, f"id: goal {goal.id} is running already; one that replaces it needs its own"
            )
        if not kept.free and goal.kept is not kept:
            raise Refusal(
                codes.INVALID_GOAL, "what is to be kept out of changed while the goal was planned; send it again"
            )
        stages = self.switching.from_here(goal.plan.transitions[0].stages)
        if (touched := self.switching.touched(stages)) is not None:
            raise Refusal(codes.INVALID_GOAL, f"on the way from where the arm is, {touched}")
        return stages

    def begin(self, goal: Planned, stages: States, now: float) -> None:
        """Makes a goal the running one, which begins with stages (k, A), see `first`."""
        first, *others = goal.plan.transitions
        lead = self._lead * len(stages) + max(self.switching.ready(stages[0]) - now, 0.0)
        self.execution = Execution(goal, start(goal.plan.trajectory, lead, now, time.time()), self._lead)
        if not np.array_equal(stages, first.stages):
            self.execution.plan = replace(goal.plan, transitions=(Staged(stages, None), *others))
        self._accepted += 1
        self._ledger.accepted(self._accepted, goal.id, len(goal.plan.trajectory.waypoints))

    def improve(self, arrival: int, plan: Plan, kept: Kept | None = None) -> None:
        """Takes a better plan for what is left of the goal of this arrival, if that is the running one.

        But none that keeps clear of something else than what is to be kept clear of now.
        """
        now = self._avoidance.kept
        if self.execution is not None and self.execution.goal.arrival == arrival and (now.free or kept is now):
            self.execution.improve(plan)

    def judge(self, ended: Callable[[Judged], None]) -> None:
        """Has what is left of the running goal looked through, beside the loop, for what it touches."""
        if (execution := self.execution) is not None:
            arrival = execution.goal.arrival
            self._avoidance.judge(
                self._boards.outputs(), execution.left, lambda kept, touched: ended(Judged(arrival, kept, touched))
            )

    def judged(self, event: Judged) -> str | None:
        """Ends the goal that was looked through, if it is running yet and touches; returns a sentence on that."""
        running = self.execution is not None and self.execution.goal.arrival == event.arrival
        if not running or event.touched is None or event.kept is not self._avoidance.kept:
            return None
        return self.abort(event.touched)

    def follow(self, wish: Follow) -> None:
        """Ends the running goal for a moving one, or has the next of its wishes replace the last.

        But not while the last waits: what is known then would always be of a wish before.
        """
        if self.execution is not None:
            self.end("replaced", codes.INVALID_GOAL, "replaced by a setpoint")
        last = self.following
        if self._waits and last is not None and wish.configuration is not None and wish.previous is last.previous:
            wish = replace(last, until=wish.until)
        self.following = wish

    def advance(self, now: float, held: bool = False) -> str | None:
        """Does what is due at `now`; returns a sentence on the end of the goal or stream when that has come.

        What may touch something waits, with the arm holding, until it is known not to.

        Args:
            now: [s].
            held: whether nothing is to move, for a goal waits to begin from where the arm is.

        Raises:
            BusBusy: the bus has taken no frame for too long.
        """
        self._now, self._waits = now, False
        try:
            return None if held else self._go_on(now)
        except Unknown:
            self._waits, self.switching.busy_since = True, None
            return None

    def _go_on(self, now: float) -> str | None:
        """Does what is due.

        Raises:
            BusBusy: the bus has taken no frame for too long.
            Unknown: what is due may touch something.
        """
        if self.following is not None:
            return self._pursue(self.following, now)
        execution = self.execution
        if execution is None:
            return None
        if execution.checked < execution.point and now >= execution.settled_at - 1e-9 and not self._boards.moving(now):
            end = self._check(execution)
            if end is not None:
                return end
        due = execution.due(now)
        if due is None:
            return None
        try:
            self._switch(execution, *self._clear(execution, *due), now)
        except Touching as error:
            return self.abort(str(error))
        return None

    def abort(self, touched: str) -> str:
        """Ends the running goal that would touch something; returns a sentence on it."""
        goal = "" if self.execution is None else f"; goal {self.execution.goal.id} was aborted"
        self.end("aborted", codes.PATH_TOLERANCE_VIOLATED, f"on the way that was planned, {touched}; the arm holds")
        return f"holding{goal}: on the way that was planned, {touched}"

    def _clear(self, execution: Execution, point: int, stage: int) -> tuple[int, int]:
        """Returns point and stage to switch to where those are due: none is passed over if that touched something."""
        if self._avoidance.kept.free:
            return point, stage
        onward, transitions = execution.onward(point, stage), execution.plan.transitions
        fitting = (at for at in reversed(onward) if self.switching.fitting(transitions[at[0]].stages[at[1]]))
        return next(fitting, onward[0])

    def _switch(self, execution: Execution, point: int, stage: int, now: float) -> None:
        """Switches to a stage of the way to a point, or as near to it as may be.

        Raises:
            BusBusy: the bus has taken no frame for too long.
            Touching: something would be touched on the way.
        """
        done = execution.stage if point == execution.point else -1
        first = done + 1 if self._avoidance.kept.free else stage
        before, commits = self.switching.switches, self.switching.commits
        reached = self.switching.toward(execution.plan.transitions[point].stages[first : stage + 1], now)
        switches = self.switching.switches - before
        if reached is not None or switches:
            at = done if reached is None else first + reached
            execution.switched(point, at, switches, self.switching.commits - commits, now, self._travel)

    def end(self, status: str, code: int, message: str) -> bool:
        """Tells the running goal its result, and follows nothing; returns whether there was a goal."""
        execution, self.execution = self.execution, None
        self.following = self.switching.busy_since = None
        late = self.switching.note(self._now) or 0
        if execution is None:
            return False
        execution.switches += late
        result = {"id": execution.goal.id, "status": status, "code": code, "message": message}
        self._publish("result", {**result, "switches": execution.switches, **self._where(execution), **bias(execution)})
        self._ledger.ended(self._accepted, status, code, message, execution.switches)
        return True

    def _pursue(self, wish: Follow, now: float) -> str | None:
        """Switches to the configuration wished for when the last transition, or its last stage, is settled.

        Raises:
            BusBusy: the bus has taken no frame for too long.
        """
        switching = self.switching
        if now > wish.until:
            self.following = switching.busy_since = None
            return "holding; the stream of setpoints has stopped"
        switching.note(now)  # a SYNC may have left late
        if wish.configuration is None or wish.previous is not switching.commanded:  # switched meanwhile
            switching.busy_since = None
        elif now >= switching.free_at and not self._boards.moving(now):
            states = self._manipulator.actuator_states(wish.configuration)
            try:
                self.following = self._toward(wish, states[None] if wish.stages is None else wish.stages, now)
            except Touching:  # the follower is to find another way
                self.following = replace(wish, configuration=None)
        return None

    def _toward(self, wish: Follow, stages: States, now: float) -> Follow:
        """Switches to the last of the stages (k, A) that may be reached at once; returns what is wished for then.

        Raises:
            BusBusy: the bus has taken no frame for too long.
            Touching: something would be touched on the way.
        """
        last = len(stages) - 1
        if not self._avoidance.kept.free:
            last = max((k for k in range(len(stages)) if self.switching.fitting(stages[k])), default=0)
        whole, stages = last == len(stages) - 1, stages[last : last + 1]
        reached = self.switching.toward(stages, now)
        return wish if whole and reached is not None else replace(wish, previous=self.switching.commanded)

    def _check(self, execution: Execution) -> str | None:
        """Sees to the point last switched to, now that it is settled; returns a sentence if that ends the goal."""
        execution.checked = execution.point
        where = self._where(execution)
        if not execution.plan.trajectory.between(execution.point):
            self._publish("feedback", feedback(execution, where))
        verdict = at_the_end(execution, where) if execution.last else on_the_way(execution, where)
        if verdict is None:
            return None
        self.end(verdict.status, verdict.code, verdict.message)
        return verdict.sentence

    def _where(self, execution: Execution) -> Payload:
        """Returns where the arm is measured, see whereabouts."""
        try:
            return whereabouts(self._manipulator, self._boards.measured(), execution)
        except Exception:  # a defect there must not keep a goal from its result
            log.exception("the boards' states cannot be had")
            return UNKNOWN
