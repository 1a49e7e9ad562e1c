"""Programs in flight: offered to the executor, accepted, replaced; their feedback and improvements."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from hyperbit.controller.motion.stages.feed import Feed, Improved
from hyperbit.controller.planning.core.arm import ArmState
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Publish, Record, Reply, ToExecutor
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.reports import GoalOutcome, Report, collision_outcome
from hyperbit.controller.planning.core.results import KnownProgram
from hyperbit.controller.planning.core.tasks import (
    Answer,
    CheckStages,
    Deviations,
    ImprovePlan,
    Tables,
    VersionedScene,
    collision_of,
)
from hyperbit.controller.program import Accepted, Begun, Cancel, Ended, Program, Replaced, Settled
from hyperbit.controller.refusals.codes import PATH_TOLERANCE_VIOLATED

GAVE_UP = "the planner gave up waiting for the executor"


@dataclass(eq=False)
class InFlight:
    """One program, from its sending to its result.

    Attributes:
        program: as it was sent.
        request: number of the client's request; its answer waits until the ledger has the acceptance.
        entry: number of that entry of the ledger.
        delay: the trajectory's t = 0 in the program's time [s].
        begin: its zero of time [s].
        outcome: the planner's reason to end it; the executor's result follows.
        improving, checking: numbers of the tasks that improve and check it.
        deviates: whether the deviations of its points are still awaited.
        held: reports that wait for the deviations, in order.
        unchecked: whether it cannot be checked, because it is not known where the arm is.
        switches: as the executor told last.
    """

    program: Program
    request: int
    report: Report
    feed: Feed
    answer: dict[str, Any]
    entry: int = 0
    plan: Any = None
    tables: Tables | None = None
    delay: float = 0.0
    begin: float = 0.0
    accepted: bool = False
    outcome: GoalOutcome | None = None
    improving: int | None = None
    deviates: bool = False
    held: deque[Settled | Ended] = field(default_factory=deque)
    checking: int | None = None
    unchecked: bool = False
    switches: int = 0


class Programs:
    """The owner of what is in flight.

    Attributes:
        last_accepted: number of the latest program that the executor accepted.

    Args:
        searches: whether plans are improved while they run.
    """

    def __init__(self, parts: Parts, searches: bool) -> None:
        self.last_accepted = 0
        self._view, self._jobs, self._moment, self._act = parts.view, parts.jobs, parts.moment, parts.act
        self._obstacles, self._results, self._searches = parts.obstacles, parts.results, searches
        self._programs: dict[int, InFlight] = {}
        self._replies: dict[int, tuple[int, dict[str, Any]]] = {}  # by entry of the ledger

    # --- what is in flight

    @property
    def current(self) -> InFlight | None:
        """The running program; None if there is none."""
        running = [program for program in self._programs.values() if program.accepted]
        return running[-1] if running else None

    def running(self, goal: str) -> InFlight | None:
        """Returns the accepted or offered program of a goal; None if there is none."""
        return next((program for program in self._programs.values() if program.report.id == goal), None)

    @property
    def improving(self) -> bool:
        """Whether a worker improves a running program."""
        return any(program.improving is not None for program in self._programs.values())

    @property
    def offered(self) -> bool:
        """Whether a program waits for the executor's answer."""
        return any(not program.accepted for program in self._programs.values())

    @property
    def idle(self) -> bool:
        """Whether nothing is in flight, and no answer waits for the ledger."""
        return not self._programs and not self._replies

    def unchecked(self) -> list[str]:
        """Returns the ids of programs whose stages are not yet checked among the present obstacles."""
        running = [program for program in self._programs.values() if program.outcome is None]
        return [program.report.id for program in running if program.feed.waits_for_check]

    # --- sending

    def send_program(self, program: InFlight) -> None:
        """Sends a program."""
        self._programs[program.program.program] = program
        self._act(ToExecutor(program.program))

    def withdraw(self, number: int) -> None:
        """Abandons a program that the executor declined or does not answer; its result will not be published."""
        if self._programs.pop(number, None) is not None:
            self._results.waive(self._identity(number))

    def give_up(self, number: int) -> None:
        """Withdraws a program, and cancels it in case the executor accepts it late."""
        self.withdraw(number)
        self._cancel(number, GAVE_UP)

    def end(self, program: InFlight, outcome: GoalOutcome) -> None:
        """Cancels a running program at the executor; the outcome becomes its result."""
        if program.outcome is None:
            program.outcome = outcome
            self._stop_tasks(program)
            self._cancel(program.program.program, outcome.message)

    def pause_improvement(self) -> None:
        """Frees the worker of goals for a goal that waits; the running goal continues as planned so far."""
        for program in list(self._programs.values()):
            self._stop_improving(program)
            self._tell(program)

    # --- the executor

    def accepted(self, message: Accepted) -> None:
        """Handles the acceptance of a program; cancels a program that was abandoned meanwhile."""
        program = self._programs.get(message.program)
        if program is None:
            self._cancel(message.program, GAVE_UP)
            return
        program.accepted, program.begin, self.last_accepted = True, message.begin, message.program
        program.entry = self._results.next_entry()
        self._replies[program.entry] = program.request, program.answer
        accepted = AcceptanceEntry(program.report.id, self._moment.wall, program.report.count)
        self._act(Record(program.entry, self._identity(message.program), accepted, None))
        self._improve(program)
        self._feed(program)

    def recorded(self, entry: int) -> None:
        """Answers the request of a program whose acceptance the ledger has."""
        if (reply := self._replies.pop(entry, None)) is not None:
            self._act(Reply(*reply))

    def receive_report(self, message: Begun | Replaced | Settled | Ended) -> None:
        """Handles what the executor tells of a program, own or of an earlier planner process."""
        program = self._programs.get(message.program)
        if program is None:
            if isinstance(message, Ended):
                self._results.ended(message, None)
            return
        match message:
            case Begun():
                program.switches = message.switches
                program.report.begun(program.feed.begin(message.stage))
                self._feed(program)
            case Replaced():
                program.feed.answered(message.generation, message.accepted)
                self._feed(program)
            case Settled():
                program.switches = message.switches
                program.report.begun(message.mark)
                if (outcome := program.report.left_path(message.mark, self._view.measured_in(message))) is not None:
                    self.end(program, outcome)
                program.held.append(message)
                self._tell(program)
            case Ended():
                self._stop_checking(program)
                program.held.append(message)
                self._tell(program)

    def lost(self, reason: str) -> None:
        """Ends all accepted programs as aborted, because the executor is lost; the others are withdrawn."""
        for program in list(self._programs.values()):
            if not program.accepted:
                self.withdraw(program.program.program)
                continue
            program.deviates = False
            self._tell(program)
            if self._programs.pop(program.program.program, None) is not None:
                self._stop_tasks(program)
                outcome = program.outcome or GoalOutcome("aborted", PATH_TOLERANCE_VIOLATED, reason)
                known = KnownProgram(outcome, None, None, self._unrecorded(program))
                identity = self._identity(program.program.program)
                self._results.lost(identity, program.program.context, known, program.switches)

    # --- obstacles

    def park(self, generation: int) -> None:
        """Withdraws the stages that have not begun of all programs, because obstacles have changed."""
        for program in list(self._programs.values()):
            if program.feed.checked != generation and not program.unchecked:
                self._stop_tasks(program)
                self._tell(program)
                program.feed.park(generation)
                self._feed(program)

    def check(self) -> None:
        """Starts the checks of parked programs as soon as the obstacles are built. Call at the end of each step."""
        scene, state = self._obstacles.scene, self._view.state
        if scene is None or state is None:
            return
        for program in self._programs.values():
            waits = program.feed.waits_for_check and program.checking is None
            if waits and program.accepted and program.outcome is None:
                self._check(program, scene, state)

    def _check(self, program: InFlight, scene: VersionedScene, state: ArmState) -> None:
        """Starts the check of the next stages of a program, or releases them if there is nothing to collide with."""
        while (unchecked := program.feed.to_check()) is not None:
            if not scene.free:
                stages = tuple(map(state.real, unchecked.stages))
                task = CheckStages(scene, state.real(unchecked.before), stages)
                program.checking = self._jobs.start(task, partial(self._checked, program, unchecked.until))
                return
            program.feed.note_clear(unchecked.until)
        self._obstacles.note(f"goal {program.report.id} goes on, its stages are clear")
        self._feed(program)

    def _checked(self, program: InFlight, until: int, answer: Answer) -> None:
        """Releases the stages that a check found clear; ends a program that would collide."""
        program.checking = None
        if (words := collision_of(answer)) is not None:
            self._obstacles.note(f"goal {program.report.id} was aborted: it would collide: {words}")
            self.end(program, collision_outcome(program.report.id, words))
            return
        program.feed.note_clear(until)
        self._feed(program)

    # --- improvement

    def _improve(self, program: InFlight) -> None:
        scene = self._obstacles.scene
        if program.plan is None or program.tables is None or scene is None or scene.generation != program.feed.checked:
            return
        task = ImprovePlan(program.plan, program.begin + program.delay, self._searches, program.tables, scene)
        program.deviates = True
        program.improving = self._jobs.start(task, partial(self._improved, program))

    def _improved(self, program: InFlight, answer: Answer) -> None:
        """Takes deviations and better plans."""
        match answer:
            case Deviations(values):
                program.feed.note_deviations(values)
                program.deviates = False
            case Improved():
                program.feed.improve(answer)
                self._feed(program)
            case _:  # the last answer
                self._stop_improving(program)
        self._tell(program)

    # --- the end of tasks

    def _stop_improving(self, program: InFlight) -> None:
        self._jobs.abandon(program.improving)
        program.improving, program.deviates = None, False

    def _stop_checking(self, program: InFlight) -> None:
        self._jobs.abandon(program.checking)
        program.checking = None

    def _stop_tasks(self, program: InFlight) -> None:
        self._stop_improving(program)
        self._stop_checking(program)

    # ---

    def _unrecorded(self, program: InFlight) -> int | None:
        """Returns the entry of an acceptance that the ledger does not have yet; None if it has."""
        return program.entry if program.entry in self._replies else None

    def _tell(self, program: InFlight) -> None:
        """Publishes what waits: feedback in order, then the result."""
        while program.held and not program.deviates:
            message = program.held.popleft()
            if isinstance(message, Ended):
                self._stop_tasks(program)
                del self._programs[message.program]
                report, feed = program.report, program.feed
                self._results.ended(
                    message, KnownProgram(program.outcome, report.present, feed.proof, self._unrecorded(program))
                )
                continue
            deviation = program.feed.deviation(message.mark) if message.planned else None
            feedback = program.report.settled(message, self._view.measured_in(message), deviation)
            if feedback is not None:
                self._act(Publish("feedback", feedback))

    def _feed(self, program: InFlight) -> None:
        """Sends the next part of a running program."""
        if program.accepted and program.outcome is None and (message := program.feed.message()) is not None:
            self._act(ToExecutor(message))

    def _cancel(self, number: int, reason: str) -> None:
        self._act(ToExecutor(Cancel(0, number, reason[:1_000])))

    def _identity(self, number: int) -> Identity:
        return Identity(self._view.instance or 0, number)
