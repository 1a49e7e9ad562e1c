"""What the planner does, for the story of a world and its account."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hyperbit.controller.host.process import Log
from hyperbit.controller.planning.core.events import (
    Action,
    Answered,
    Event,
    FromExecutor,
    SetpointArrived,
    Start,
    ToExecutor,
)
from hyperbit.controller.program import Alive, Snapshot
from tests.simulation.statements.exchange import Exchange


class PlannerWitness:
    """Sees what the planner does; also the recorder of its core."""

    def __init__(self, exchange: Exchange, note: Callable[[object], None]) -> None:
        self._exchange, self._note = exchange, note

    def acts(self, action: Action) -> None:
        """Takes an action before it is carried out."""
        match action:
            case ToExecutor(message) if not isinstance(message, Alive):
                self._note(("planner sends", message))
            case Start(number, task):
                self._note(("task", number, type(task).__name__))
            case Log(_, text):
                self._note(("planner logs", text))
                self._exchange.account.see("planner_logs", text)

    def __call__(self, event: Event, now: float, wall: float, actions: Sequence[Action] | None) -> None:
        """Takes a step of the core."""
        match event:
            case FromExecutor(message) if not isinstance(message, Snapshot):
                self._note(("planner hears", message))
            case Answered(number, answer, _):
                self._note(("worker answers", number, answer))
            case SetpointArrived(payload, arrival, sender):
                self._exchange.takes_setpoint(payload, sender, now - arrival.at)

    def flush(self) -> None:
        """Does nothing: each step is noted at once."""
