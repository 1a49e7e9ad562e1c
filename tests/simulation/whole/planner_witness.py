"""What the planner does, as facts for the judge: actions, steps of its core, and answers of its workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hyperbit.controller.host.process import Log
from hyperbit.controller.motion.stages.feed import Improved
from hyperbit.controller.planning.core.events import (
    Abandon,
    Action,
    Answered,
    Disconnect,
    Event,
    FromExecutor,
    Hurry,
    LinkDown,
    Record,
    SetpointArrived,
    Start,
    TipArrived,
    ToExecutor,
)
from hyperbit.controller.planning.core.tasks import (
    Answer,
    BuildScene,
    BuildTables,
    Deviations,
    Failed,
    Planned,
    SceneBuilt,
    Tables,
    Task,
)
from hyperbit.controller.program import Alive, Setpoint, Snapshot
from tests.simulation.agenda import Agenda
from tests.simulation.judge.interface.interface import InterfaceJudge
from tests.simulation.judge.verdict import Violation
from tests.simulation.whole.searcher import Mood
from tests.simulation.whole.tasks_seen import seen


class PlannerWitness:
    """Sees what the planner does; also the recorder of its core."""

    def __init__(self, judge: InterfaceJudge, agenda: Agenda, mood: Mood, note: Callable[[object], None]) -> None:
        self._judge, self._agenda, self._mood, self._note = judge, agenda, mood, note

    def task_ends(self, number: int, task: Task, answer: Answer) -> None:
        """Takes the last answer of a worker."""
        self._judge.at(self._agenda.now)
        self._judge.searches.ends(number, isinstance(answer, Planned))
        if isinstance(answer, Failed):
            self._judge.account.note("task failed")
        if isinstance(task, BuildTables):
            self._judge.tables_built(answer.locked if isinstance(answer, Tables) else None)
        if isinstance(task, BuildScene):
            self._judge.scene_built(isinstance(answer, SceneBuilt))

    def acts(self, action: Action) -> None:
        """Takes an action before it is carried out."""
        match action:
            case ToExecutor(message):
                self._judge.at(self._agenda.now)
                self._judge.link.hands_out(message)
                if isinstance(message, Setpoint):
                    self._judge.streams.sends(message)
                if not isinstance(message, Alive):
                    self._note(("planner sends", message))
            case Start(number, task):
                self._note(("task", number, type(task).__name__))
                self._judge.at(self._agenda.now)
                if self._mood.disturbed:
                    self._judge.account.note("slow search")
                if isinstance(task, BuildScene):
                    self._judge.scene_begun()
                self._judge.task(seen(number, task))
            case Disconnect(reason):
                self._judge.at(self._agenda.now)
                self._judge.link.gives_up(reason)
            case Hurry(number):
                self._judge.at(self._agenda.now)
                self._judge.searches.hurries(number)
            case Abandon(number):
                self._judge.at(self._agenda.now)
                self._judge.searches.abandons(number)
            case Record(_, _, accepted, ended) if accepted is not None and ended is not None:
                self._judge.at(self._agenda.now)
                self._judge.results.records(accepted.goal)
            case Log(level, text, fields):
                self._note(("planner logs", text))
                self._judge.at(self._agenda.now)
                self._judge.journal.logs(level, text, fields)
                if "Traceback" in text:
                    raise Violation(f"internal error: {text}")
            case _:
                pass

    def __call__(self, event: Event, now: float, wall: float, actions: Sequence[Action] | None) -> None:
        """Takes a step of the core."""
        match event:
            case FromExecutor(message):
                if not isinstance(message, Snapshot):
                    self._note(("planner hears", message))
            case LinkDown():
                self._judge.at(self._agenda.now)
                self._judge.account.notices_loss()
            case Answered(number, answer, _):
                if isinstance(answer, Deviations | Improved):
                    self._judge.at(self._agenda.now)
                    self._judge.searches.improves(number, getattr(answer, "values", None))
                self._note(("worker answers", number, answer))
            case SetpointArrived(payload, arrival, sender):
                self._judge.at(self._agenda.now)
                self._judge.takes_setpoint(payload, sender, arrival.at, now)
            case TipArrived(payload, arrival, sender):
                self._judge.at(self._agenda.now)
                self._judge.mailboxes["measured_tip"].taken(payload, sender, arrival.at)
                self._judge.streams.tip(payload, now)
            case _:
                pass
        self._judge.searches.steps += 1

    def flush(self) -> None:
        """Does nothing: each step is noted at once."""
