"""Programs in flight: offered to the executor, accepted, replaced; their feedback and improvements."""

from functools import partial

from hyperbit.controller.motion.stages.feed import Improved
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Publish, Record, Reply, ToExecutor
from hyperbit.controller.planning.core.goal import Goal, GoalOutcome
from hyperbit.controller.planning.core.obstacles import ObstacleOwner
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.results import Results
from hyperbit.controller.program import Accepted, Begun, Cancel, Ended, Replaced, Settled
from hyperbit.controller.refusals.codes import PATH_TOLERANCE_VIOLATED

GAVE_UP = "the planner gave up waiting for the executor"


class Programs:
    def __init__(self, parts: Parts, obstacles: ObstacleOwner, results: Results, improves: bool) -> None:
        self.last_accepted = 0  # number of the latest program that the executor accepted
        self._view, self._jobs, self._moment, self._act = parts.view, parts.jobs, parts.moment, parts.act
        self._requests, self._obstacles, self._results, self._improves = parts.requests, obstacles, results, improves

    # --- what is in flight

    @property
    def all(self) -> list[Goal]:
        return [goal for goal in self._requests.of(Goal) if goal.state in ("offered", "running")]

    @property
    def current(self) -> Goal | None:
        return next((goal for goal in reversed(self.all) if goal.state == "running"), None)

    @property
    def offered(self) -> Goal | None:
        return next((goal for goal in self.all if goal.state == "offered"), None)

    @property
    def improving(self) -> bool:
        return any(goal.job is not None for goal in self.all)

    def find(self, goal: str) -> Goal | None:
        return next((found for found in self.all if found.id == goal), None)

    def unchecked(self) -> list[str]:
        return [goal.id for goal in self.all if goal.outcome is None and goal.feed.waits_for_check]

    def checks(self) -> list[int | None]:
        return [goal.checking for goal in self.all]

    def check(self) -> None:
        """Asserts that the reports on each program come soon, and what ended goals wait for; see `Core.check`."""
        numbers = [goal.program.program for goal in self.all]
        assert len(numbers) == len(set(numbers)), f"two goals have one program: {numbers}"
        assert not numbers or self._view.connected, f"without an executor run {[goal.id for goal in self.all]}"
        for goal in self._requests.of(Goal):
            assert not goal.held or goal.deviates, f"reports on {goal.id} wait for nothing"
            assert not goal.deviates or goal.job is not None, f"{goal.id} waits for deviations that nobody computes"
            assert goal.outcome is None or goal.job is goal.checking is None, f"tasks of {goal.id}, which was ended"
            assert goal.state != "ended" or goal.unrecorded is not None, f"{goal.id} is over, and waits"
            assert goal.publication is None or goal.state == "ended", f"{goal.id} has a result, and is {goal.state}"

    # --- sending

    def offer(self, goal: Goal) -> None:
        goal.state = "offered"
        self._act(ToExecutor(goal.program))

    def withdraw(self, goal: Goal) -> None:
        """Abandons a program that the executor declined or does not answer; its result is not published."""
        goal.state = "waiting"
        self._results.waive(self._identity(goal.program.program))

    def give_up(self, goal: Goal) -> None:
        """Withdraws a program, and cancels it in case the executor accepts it late."""
        self.withdraw(goal)
        self._act(ToExecutor(Cancel(0, goal.program.program, GAVE_UP)))

    def end(self, goal: Goal, message: str, sentence: str = "") -> None:
        """Cancels a running program at the executor; with the result `message`. `sentence`: for the mode's reason."""
        if goal.outcome is not None:
            return
        self._stop_tasks(goal)
        self._tell(goal)  # the program may have ended, and its result may wait for the deviations
        if goal.state == "running":
            goal.outcome = GoalOutcome("aborted", PATH_TOLERANCE_VIOLATED, message, sentence)
            self._act(ToExecutor(Cancel(0, goal.program.program, message[:1_000])))

    def pause_improvement(self) -> None:
        """Frees the worker of goals for a goal that waits; the running goal continues as planned so far."""
        for goal in self.all:
            self._stop_improving(goal)
            self._tell(goal)

    # --- the executor

    def accepted(self, message: Accepted) -> None:
        goal, scene = self._of(message.program), self._obstacles.scene
        if goal is None:
            self._act(ToExecutor(Cancel(0, message.program, GAVE_UP)))
            return
        goal.state, goal.begin, self.last_accepted = "running", message.begin, message.program
        goal.stage_began = message.begin
        goal.unrecorded = entry = self._results.next_entry()
        acceptance = AcceptanceEntry(goal.id, self._moment.wall, 1 if goal.report is None else goal.report.count)
        self._act(Record(entry, self._identity(message.program), acceptance, None))
        planned, basis = goal.planned, goal.basis
        present = scene is not None and scene.generation == goal.feed.checked
        if scene and present and basis and isinstance(planned, tasks.Planned) and planned.plan is not None:
            task = tasks.ImprovePlan(planned.plan, goal.begin + goal.delay, self._improves, basis.tables, scene)
            goal.deviates, goal.job = True, self._jobs.start(task, partial(self._improved, goal))
        self._feed(goal)

    def recorded(self, entry: int) -> None:
        """Answers the client whose acceptance the ledger has, and publishes the result that waited for it."""
        for goal in self._requests.of(Goal):
            if goal.unrecorded == entry:
                goal.unrecorded = None
                self._act(Reply(goal.number, goal.answer))
                if goal.publication is not None:
                    self._act(goal.publication)
                if goal.state == "ended":
                    self._requests.forget(goal)

    def receive_report(self, message: Begun | Replaced | Settled | Ended) -> None:
        goal = self._of(message.program)
        if goal is None or goal.state != "running":
            if isinstance(message, Ended):
                self._results.ended(message, None)
            return
        match message:
            case Begun():
                goal.switches, point = message.switches, goal.feed.begin(message.stage)
                goal.stage_began = self._moment.now
                if goal.report is not None:
                    goal.report.point = max(goal.report.point, point)
                self._feed(goal)
            case Replaced():
                goal.feed.answered(message.generation, message.accepted)
                self._feed(goal)
            case Settled():
                goal.switches = message.switches
                if goal.report is not None:
                    goal.report.point = max(goal.report.point, message.mark)
                    if (left := goal.report.left_path(message.mark, self._view.measured_in(message))) is not None:
                        self.end(goal, left, f"holding; goal {goal.id} left its path: {left}")
                goal.held.append(message)
                self._tell(goal)
            case Ended():
                self._stop_checking(goal)
                goal.held.append(message)
                self._tell(goal)

    def lost(self, reason: str) -> None:
        """Ends all accepted programs as aborted, because the executor is lost."""
        for goal in self.all:
            goal.deviates = False
            self._tell(goal)
            if goal.state == "running":
                self._end(goal)
                outcome = goal.outcome or GoalOutcome("aborted", PATH_TOLERANCE_VIOLATED, reason)
                identity = self._identity(goal.program.program)
                self._results.lost(identity, goal.program.context, outcome, goal.switches, goal)

    # --- obstacles

    def park(self, generation: int) -> None:
        for goal in self.all:
            if goal.feed.checked != generation and not goal.unchecked:
                self._stop_tasks(goal)
                self._tell(goal)
                goal.feed.park(generation)
                self._feed(goal)

    def check_parked(self) -> None:
        """Starts the checks of parked programs as soon as the obstacles are built. Call at the end of each step."""
        scene, state = self._obstacles.scene, self._view.state
        if scene is None or state is None:
            return
        for goal in self.all:
            waits = goal.feed.waits_for_check and goal.checking is None
            if not waits or goal.state != "running" or goal.outcome is not None:
                continue
            while (unchecked := goal.feed.to_check()) is not None and scene.free:
                goal.feed.note_clear(unchecked.until)
            if unchecked is not None:
                real = state.start.real
                task = tasks.CheckStages(scene, real(unchecked.before), tuple(map(real, unchecked.stages)))
                goal.checking = self._jobs.start(task, partial(self._checked, goal, unchecked.until))
            else:
                self._obstacles.note(f"goal {goal.id} goes on, its stages are clear")
                self._feed(goal)

    def _checked(self, goal: Goal, until: int, answer: tasks.Answer) -> None:
        """Releases the stages that a check found clear; ends a program that would collide."""
        goal.checking = None
        if (words := tasks.collision_of(answer)) is not None:
            self._obstacles.note(f"goal {goal.id} was aborted: it would collide: {words}")
            collides = f"the planned motion would collide: {words}"
            self.end(goal, f"{collides}; the arm holds", f"holding; goal {goal.id} was aborted: {collides}")
            return
        goal.feed.note_clear(until)
        self._feed(goal)

    # --- tasks

    def _improved(self, goal: Goal, answer: tasks.Answer) -> None:
        match answer:
            case tasks.Deviations(values):
                goal.feed.note_deviations(values)
                goal.deviates = False
            case Improved():
                goal.feed.improve(answer)
                self._feed(goal)
            case _:  # the last answer
                self._stop_improving(goal)
        self._tell(goal)

    def _stop_improving(self, goal: Goal) -> None:
        self._jobs.abandon(goal.job)
        goal.job, goal.deviates = None, False

    def _stop_checking(self, goal: Goal) -> None:
        self._jobs.abandon(goal.checking)
        goal.checking = None

    def _stop_tasks(self, goal: Goal) -> None:
        self._stop_improving(goal)
        self._stop_checking(goal)

    # ---

    def _tell(self, goal: Goal) -> None:
        """Publishes waiting messages: feedback in order, then the result."""
        while goal.held and not goal.deviates:
            message = goal.held.popleft()
            if isinstance(message, Ended):
                self._end(goal)
                self._results.ended(message, goal)
            elif goal.report is not None:
                deviation = goal.feed.deviation(message.mark) if message.planned else None
                remaining = round(max(goal.end - self._moment.now, 0.0), 3)
                feedback = goal.report.settled(message, self._view.measured_in(message), deviation, remaining)
                if feedback is not None:
                    self._act(Publish("feedback", feedback))

    def _feed(self, goal: Goal) -> None:
        if goal.state == "running" and goal.outcome is None and (message := goal.feed.message()) is not None:
            self._act(ToExecutor(message))

    def _end(self, goal: Goal) -> None:
        self._stop_tasks(goal)
        goal.state = "ended"
        if goal.unrecorded is None:
            self._requests.forget(goal)

    def _of(self, number: int) -> Goal | None:
        return next((goal for goal in self.all if goal.program.program == number), None)

    def _identity(self, number: int) -> Identity:
        return Identity(self._view.instance or 0, number)
