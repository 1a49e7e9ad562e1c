"""The core of the planner: takes events and returns actions. It has no clock, no I/O, no threads and no search."""

from __future__ import annotations

import logging
import math
import traceback
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller import program
from hyperbit.controller.host.process import Log, Quit
from hyperbit.controller.messages.arm import Running
from hyperbit.controller.messages.goals import internal_error
from hyperbit.controller.motion.tracking.tracking import tracking_of
from hyperbit.controller.planning.core import events
from hyperbit.controller.planning.core.arm import ExecutorView
from hyperbit.controller.planning.core.goal import Goal
from hyperbit.controller.planning.core.goals import Goals
from hyperbit.controller.planning.core.obstacles import ObstacleOwner
from hyperbit.controller.planning.core.parts import Parts, Pending
from hyperbit.controller.planning.core.premises import Locks, Premises, TipBiasEstimator
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.planning.core.requests import ExecutorRequests, Queries
from hyperbit.controller.planning.core.results import Results
from hyperbit.controller.planning.core.status import Status
from hyperbit.controller.planning.core.stream import Stream
from hyperbit.controller.planning.core.tasks import ImprovePlan, Planned, Tables, VersionedScene
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.search.method import MINIMUM_SWITCH

if TYPE_CHECKING:
    from hyperbit.controller.arm.arm import Arm
    from hyperbit.controller.motion.stages.pacing import Pace

# Opaque fields for the core; the flight recorder omits them.
OPAQUE: dict[type, str] = {Tables: "solvers", VersionedScene: "keep_out", ImprovePlan: "plan", Planned: "plan"}
CALM = 0.003  # [s] after an action that is not a report, before the next report
LAST_RESULTS_WITHIN = 1.0  # [s] at the end for the executor to end the running goal


class Beginning(NamedTuple):
    name: str  # of this process, unique; a part of ids
    tables: Tables  # for the locks of the arm's file
    scene: VersionedScene  # the obstacles of the arm's file
    obstacles: int  # their number
    counts: tuple[int, ...]  # switches of each actuator, of the ledger
    # Results that earlier planner processes published, and goals that they accepted without a result in the ledger.
    published: Mapping[events.Identity, events.ResultEntry]
    owed: Mapping[events.Identity, events.AcceptanceEntry]
    simulated: bool  # whether this process serves an executor with simulated boards; it connects to no other


class Core:
    def __init__(self, arm: Arm, pace: Pace, beginning: Beginning) -> None:
        manipulator, searches, tracker = arm.manipulator, arm.settings.method == MINIMUM_SWITCH, arm.settings.tracker
        self.ended = False  # whether the process may end, after a `Quit`
        self._actions: list[events.Action] = []
        self._counts = beginning.counts
        self._view = view = ExecutorView(manipulator, arm.travel_time, pace)
        self._parts = parts = Parts(view, pace, beginning.name, self._act, beginning.simulated)
        self.admission, self._jobs, self._moment = parts.admission, parts.jobs, parts.moment
        self._locks = locks = Locks(parts, beginning.tables)
        self._obstacles = ObstacleOwner(parts, beginning.scene, beginning.obstacles)
        self._tip_bias = None if tracker is None else TipBiasEstimator(parts, locks, tracker)
        premises = Premises(view, locks, self._obstacles, self._tip_bias)
        self._results = Results(parts, beginning.published, beginning.owed)
        self._programs = programs = Programs(parts, self._obstacles, self._results, searches)
        self._goals, self._queries = Goals(parts, premises, programs, searches), Queries(parts, premises)
        self._requests = ExecutorRequests(parts, premises, self._goals, programs, self._queries)
        self._stream = Stream(arm, tracking_of(manipulator.length, arm.tolerance), parts, premises, programs)
        self._status = Status(parts, premises, programs, self._goals, self._queries, self._stream)
        self._report_at = self._alive_at = 0.0  # times of the next report and keep-alive [s]
        self._most_silent = round(2.0 * arm.settings.planner_timeout / program.ALIVE_EVERY)
        self._silent = 0  # keep-alives since the executor's last message
        self._quit_at: float | None = None

    def step(self, event: events.Event, now: float, wall: float) -> list[events.Action]:
        """Handles an event; returns the actions, in order.

        `now` is of CLOCK_MONOTONIC, or of any clock that never goes back [s]; `wall` is UNIX time [s].
        """
        self._moment.now, self._moment.wall = now, wall
        self._handle(event)
        self._obstacles.check_standing()
        self._programs.check_parked()
        self._requests.advance()
        self._goals.advance()
        self._queries.advance()
        self._stream.consider()
        self._obstacles.answer(self._programs.unchecked())
        self._keep_alive()
        if self._quit_at is not None and not self.ended:
            over = self._results.idle and not self._parts.requests.of(Goal)
            if over or now >= self._quit_at:
                self._obstacles.answer([], at_once=True)
                self._status.publish_state()
                self.ended = True
        if self._actions and not isinstance(event, events.Tick):
            self._report_at = now + CALM  # urgent actions, and their worker, come before reports
        if now >= self._report_at:
            self._status.report()
        due = min(self._alive_at, self._goals.due, self._stream.due, max(self._report_at, self._status.due))
        if self._quit_at is not None:
            due = math.inf if self.ended else min(due, self._quit_at)
        self._act(events.Wake(due))
        actions, self._actions = self._actions, []
        return actions

    def check(self) -> None:
        """Asserts what holds between two steps; for the simulation, not for the robot."""
        assert not self._actions, "an action waits for the next step"
        self._parts.check([*self._programs.checks(), self._goals.preparing])
        self._goals.check()
        self._programs.check()
        self._results.check()
        self._queries.check()
        self._requests.check()
        self._obstacles.check(self._programs.unchecked())

    def _handle(self, event: events.Event) -> None:
        prepared = isinstance(event, events.Answered) and self._jobs.prepares(event.task)
        if not prepared and not isinstance(event, events.Tick | events.SetpointArrived | events.TipArrived):
            self._status.changed = True  # `state` may have changed
        match event:
            case events.FromExecutor(message):
                self._silent = 0
                self._receive(message)
            case events.Request():
                self._answer(event)
            case events.Answered(number, answer, last):
                self._jobs.answered(number, answer, last)
            case events.SetpointArrived():
                self._stream.receive_setpoint(event)
            case events.TipArrived(payload):
                if self._tip_bias is not None:
                    self._tip_bias.receive_tip(payload)
            case events.Published(number):
                self._results.published(number)
            case events.Recorded(entry):
                self._programs.recorded(entry)
                self._results.recorded(entry)
            case events.LinkDown(reason):  # or the reason has changed
                was = self._view.connected
                self._view.lost(reason)
                if was:
                    self.admission.lost()
                    self._goals.lost(reason)
                    self._programs.lost(reason)
                    self._requests.lost(reason)
            case events.Unsent(number, reason):
                self._requests.unsent(number, reason)
            case events.Warned(warnings):
                self._status.warnings = warnings
            case Quit() if self._quit_at is None:  # refuses waiting requests, ends the goal, stays connected
                self._quit_at = self._moment.now + LAST_RESULTS_WITHIN
                self._goals.quitting = True
                self._queries.end_queries()
                self._stream.park()
                if (running := self._programs.current) is not None:
                    self._programs.end(running, Reason.SHUTTING_DOWN.sentence)

    def _answer(self, request: events.Request) -> None:
        """Handles a request. A failure is answered, and does not end the process."""
        try:
            match request.key, request.message:
                case "goal" | "jog", _:
                    self._goals.queue(request)
                case "plan", _:
                    self._queries.queue(request)
                case "obstacles", events.SentObstacles() as message:
                    if self._obstacles.change(request.number, message):
                        self._programs.park(self._obstacles.generation)
                        self._stream.park()
                case "arm", _:
                    self._act(events.Reply(request.number, self._live()))
                case _:
                    self._requests.receive_request(request)
        except Exception:
            self._act(Log(logging.ERROR, f"a request on {request.key} failed\n{traceback.format_exc()}"))
            answer = internal_error()
            if (pending := self._parts.requests.find(Pending, request.number)) is not None:
                self._parts.requests.end(pending, answer)
            else:
                self._act(events.Reply(request.number, answer))

    def _live(self) -> events.LiveArm:
        state, goal = self._view.state, self._programs.current
        faults = () if state is None else state.snapshot.faults
        waypoints = [] if goal is None or goal.report is None else goal.report.waypoints()
        return events.LiveArm(
            limits=[fault.message for fault in faults if fault.code == "board-limits"],
            sent_obstacles=self._obstacles.regions,
            simulated=self._parts.simulated,
            simulation=self._view.simulation,
            running=None if goal is None else Running(goal.id, waypoints),
        )

    def _receive(self, message: program.Up) -> None:
        match message:
            case program.Snapshot():
                self.admission.snapshot(message.epoch)
                self._locks.update(self._view.receive_snapshot(message))
                self._results.end_unsent(message.program)
            case program.Accepted():
                self._goals.accepted(message)
            case program.Declined():
                self._goals.declined(message)
            case program.Begun() | program.Replaced() | program.Settled() | program.Ended():
                self._programs.receive_report(message)
            case program.Answer():
                self._requests.answered(message)
            case program.Question():
                self._obstacles.ask(message)
            case program.Counted(counts):
                self._count(counts)
            case program.Diagnostics():
                self._view.diagnostics = message
                self._count(message.counts)
            case program.Welcome():
                self._view.receive_welcome(message, self._counts)
                self._parts.last_number = max(self._parts.last_number, message.program)
                self._act(events.ToExecutor(program.Counts(self._counts)))
                self._results.met(message.instance)
                self._silent, self._alive_at = 0, self._moment.now

    def _count(self, counts: tuple[int, ...]) -> None:
        """Records the executor's counts. The next executor gets the greatest, in case it has lost its journal."""
        if len(counts) == len(self._counts):
            self._counts = tuple(map(max, self._counts, counts))
        self._act(events.RecordCounts(counts))

    def _keep_alive(self) -> None:
        """Reports to the executor that the planner is alive, and detects a silent executor.

        Silence is counted in keep-alives, so that a stop of this process does not count as the executor's silence.
        """
        now = self._moment.now
        if now < self._alive_at:
            return
        self._alive_at = now + program.ALIVE_EVERY
        self._jobs.tick()
        if not self._view.connected:
            return
        self._act(events.ToExecutor(program.Alive()))
        self._silent += 1
        if self._silent > self._most_silent or self._requests.overdue():
            self._silent = 0
            self._act(events.Disconnect("the executor is silent"))

    def _act(self, action: events.Action) -> None:
        self._actions.append(action)
