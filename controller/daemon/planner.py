"""Planning beside the control loop: one thread takes payloads in order of arrival and makes plans of them."""

import logging
import queue
import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.daemon.avoidance import Avoidance, Guarded, Kept, keeping
from controller.daemon.events import Improved, Payload, Planned, Request
from controller.daemon.foresight import Foresight
from controller.daemon.loop import PERIOD, ControlLoop
from controller.daemon.messages import done, refused
from controller.daemon.tip import Bias
from controller.manipulator.held import carried
from controller.manipulator.manipulator import Configuration
from controller.manipulator.notation import format_configuration, pose
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import GoalMessage, check_size, parse, schedule
from controller.motion.pacing import Pace
from controller.motion.plan import Plan, plan
from controller.motion.trajectory import Trajectory
from controller.search.solver import Solver

log = logging.getLogger(__name__)

MOST_WAITING = 16
TRIES = 3  # plans of a goal, while the arm moves on or what is to be kept clear of changes
IDLE = 0.02  # [s] without a question, after which the planner prepares for one


@dataclass(frozen=True, eq=False)
class Question(Request):
    """A payload to plan: a goal to run, or a question only; `received` in UNIX seconds."""

    payload: bytes
    received: float
    run: bool


class Planner:
    """Answers every request once: itself when refused or only asked, by the control loop when it is to be run."""

    def __init__(
        self,
        arm: Arm,
        solver: Solver,
        loop: ControlLoop,
        bias: Callable[[], Bias | None] = lambda: None,
        avoidance: Avoidance | None = None,
    ) -> None:
        """Starts the thread.

        Args:
            arm: to plan for.
            solver: used by nobody else.
            loop: to run the plans.
            bias: what goals are corrected by, (dimension,).
            avoidance: what is to be kept clear of; the regions of the arm's file if absent.
        """
        self._bias = bias
        self._arm, self._loop = arm, loop
        self._guarded = Guarded(arm, solver, avoidance or Avoidance(keeping(arm)))
        self._queue: queue.Queue[Question | None] = queue.Queue()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="planner", daemon=True)
        self._thread.start()

    def use(self, solver: Solver) -> None:
        """Plans with another solver from the next question on: of the arm as it is left by the actuators held."""
        self._guarded.use(solver)

    def submit(self, question: Question) -> None:
        """Takes a question, or refuses it at once when it is too large or too many wait."""
        try:
            check_size(len(question.payload))
            self._proceed(question)
            if self._queue.qsize() >= MOST_WAITING:
                raise Refusal(codes.INVALID_GOAL, f"busy: {MOST_WAITING} goals are waiting to be planned already")
        except Refusal as refusal:
            question.reply(refused(refusal.code, str(refusal)))
        else:
            self._queue.put(question)

    def waiting(self) -> int:
        """Returns how many wait."""
        return self._queue.qsize()

    def close(self, timeout: float = 2.0) -> None:
        """Refuses what waits or is being planned, and ends the thread."""
        self._closing = True
        self._queue.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        while (question := self._next()) is not None:
            goal = None
            try:
                self._proceed(question)
                message = parse(question.payload)
                goal = message.id or uuid.uuid4().hex[:12]
                self._serve(question, message, goal)
            except Refusal as refusal:
                log.info("goal %s refused: %s", goal, refusal)
                question.reply(refused(refusal.code, str(refusal), goal))
            except Exception:
                log.exception("planning failed")
                question.reply(refused(codes.INVALID_GOAL, "internal error while planning, see the journal", goal))

    def _next(self) -> Question | None:
        """Waits for what is to be planned next; meanwhile prepares for a goal from where the arm is."""
        while True:
            try:
                return self._queue.get(timeout=IDLE)
            except queue.Empty:
                self._expect()

    def _expect(self) -> None:
        """Prepares, step by step so that nobody waits for it."""
        solver, _ = self._guarded.now()
        previous = self._previous(solver)
        if previous is None or self._arm.settings.method != "minimum-switch":
            return
        for _ in solver.expect(previous, self._arm.tolerance):
            if not self._queue.empty():
                return

    def _serve(self, question: Question, message: GoalMessage, goal: str) -> None:
        manipulator, settings = self._arm.manipulator, self._arm.settings
        pace = Pace(settings.travel_time + PERIOD, settings.inrush, settings.rest_time)
        trajectory = schedule(
            message, manipulator.dimension, self._arm.tolerance, self._arm.turn, pace, question.received
        )
        trajectory = trajectory.corrected(self._bias())
        for _ in range(TRIES):
            solver, kept, previous, found = self._plan(question, trajectory, pace)
            if kept is self._guarded.now()[1] and (kept.free or self._is_at(previous, solver)):
                break
        before = solver.manipulator.actuator_states(previous)
        ahead = Foresight(solver, found, pace) if settings.method == "minimum-switch" else None
        if question.run:
            self._loop.inbox.hand_over(Planned(question.arrival, question.reply, goal, found, kept))
            if ahead is not None:
                self._improve(question, ahead, lambda plan: kept.touched(before, stages_of(plan)) is None, kept)
        else:
            if ahead is not None:
                found = ahead.whole(hurry=lambda: self._closing or not self._queue.empty())
            question.reply(self._described(solver, previous, found))

    def _plan(self, question: Question, trajectory: Trajectory, pace: Pace) -> tuple[Solver, Kept, Configuration, Plan]:
        """Returns a plan from where the arm is, and what it was made with.

        Raises:
            Refusal: there is none.
        """
        mode, reason = self._loop.mode, self._loop.reason
        solver, kept = self._guarded.now()  # which the mode waits for
        previous = self._previous(solver)
        if previous is None or (question.run and mode not in ("ready", "executing")):
            raise Refusal(codes.INVALID_GOAL, f"the arm is {mode}: {reason}")
        method = self._arm.settings.method
        found = plan(solver, trajectory, previous, method, lambda: self._proceed(question), pace)
        touched = kept.touched(solver.manipulator.actuator_states(previous), stages_of(found))
        if touched is not None:  # looked at once more, here, so that the control loop need not
            raise Refusal(codes.GOAL_TOLERANCE_VIOLATED, f"the plan that was found is not taken: {touched}")
        return solver, kept, previous, found

    def _improve(self, question: Question, ahead: Foresight, clear: Callable[[Plan], bool], kept: Kept) -> None:
        """Betters the plan of a goal until that is done, or the goal has ended, or something else is to be planned."""
        told = None
        try:
            for better in ahead.betters():
                if better is not told and clear(better):
                    self._loop.inbox.put(Improved(question.arrival, better, kept))
                    told = better
                self._proceed(question)
                if not self._queue.empty() or not self._loop.may_run(question.arrival):
                    return
        except Refusal:  # canceled or stopped: the goal has had its answer
            return
        except Exception:
            log.exception("looking ahead failed, the goal goes on as first planned")

    def _proceed(self, question: Question) -> None:
        """Checks that the answer is still wanted.

        Raises:
            Refusal: it is not.
        """
        if self._closing:
            raise Refusal(codes.INVALID_GOAL, "the daemon is shutting down; the arm holds")
        if question.run and question.arrival <= self._loop.accept_after:
            raise Refusal(codes.INVALID_GOAL, "a cancel, stop, reset or fault came before it began")

    def _previous(self, solver: Solver) -> Configuration | None:
        """Returns the configuration to plan from, of the solver's arm; None while there is none."""
        commanded = self._loop.commanded
        try:
            return None if commanded is None else carried(commanded, self._arm.manipulator, solver.manipulator)
        except ValueError:  # what is held has changed, and this solver does not go by that yet
            return None

    def _is_at(self, configuration: Configuration, solver: Solver) -> bool:
        now = self._previous(solver)
        return now is not None and np.array_equal(configuration, now)

    def _described(self, solver: Solver, previous: Configuration, found: Plan) -> Payload:
        manipulator, left, trajectory = self._arm.manipulator, solver.manipulator, found.trajectory
        before, stages = left.actuator_states(previous), list[list[list[str]]]()
        for transition in found.transitions:
            changes = np.diff(np.vstack([before, transition.stages]).astype(int), axis=0)
            stages.append([[manipulator.actuators[a] for a in np.flatnonzero(c)] for c in changes if c.any()])
            before = transition.stages[-1]
        points = [
            {
                "t": t,
                "goal": goal if trajectory.bias is None else goal + trajectory.bias,
                "between": trajectory.between(k),
                "configuration": format_configuration(manipulator, carried(solution.configuration, left, manipulator)),
                **pose(manipulator, solution.tip),
                "error": solution.error,
                "orientation_error": solution.angle if trajectory.turns[k] < np.inf else None,
                "switches": solution.switches,
                "stages": labels,
                "excursion": transition.excursion,
                "seconds": solution.seconds,
            }
            for k, (t, goal, solution, labels, transition) in enumerate(
                zip(trajectory.times, trajectory.positions, found.solutions, stages, found.transitions, strict=True)
            )
        ]
        between = len(points) - len(trajectory.waypoints)
        along = f", {between} points between them" if between else ""
        message = f"{len(trajectory.waypoints)} waypoints{along}, {found.switches} switches"
        bias = {} if trajectory.bias is None else {"bias": trajectory.bias}
        return {**done(message), "waypoints": points, "switches": found.switches, **bias}


def stages_of(plan: Plan) -> Iterator[NDArray[np.uint8]]:
    """Yields the actuator states (A,) that each stage of a plan ends in."""
    for transition in plan.transitions:
        yield from transition.stages
