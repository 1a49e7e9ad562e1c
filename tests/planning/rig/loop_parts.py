"""A core that the test plays, and services that remember what they were asked."""

import queue
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from hyperbit.controller.planning.core.events import Action, Event
from hyperbit.controller.planning.link import ExecutorLink, Inbox
from hyperbit.controller.planning.loop import Loop, Services
from hyperbit.controller.program import Fault
from tests.waiting import PATIENCE

E = TypeVar("E")


class ScriptedCore:
    """Answers each event with the actions of its kind in `script`.

    Attributes:
        script: actions of a kind of event, or a function of the event.
    """

    ended = False

    def __init__(self) -> None:
        self.script: dict[type[Any], Sequence[Action] | Callable[[Any], Sequence[Action]]] = {}
        self.steps: list[Event] = []
        self._queue: queue.Queue[Event] = queue.Queue()

    def step(self, event: Event, now: float, wall: float) -> Sequence[Action]:
        self.steps.append(event)
        self._queue.put(event)
        actions = self.script.get(type(event), ())
        return actions(event) if callable(actions) else actions

    def expect(self, kind: type[E]) -> E:
        """Waits for the next event of a kind, and returns it; for a loop with a thread."""
        while not isinstance(event := self._queue.get(timeout=PATIENCE), kind):
            pass
        return event


class Remembering:
    """Remembers all calls of its methods; `broken` methods raise after that.

    Attributes:
        faults: what `warnings` returns.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.broken: set[str] = set()
        self.faults: tuple[Fault, ...] = ()

    def __getattr__(self, name: str) -> Callable[..., None]:
        def call(*arguments: Any) -> None:
            self.calls.append((name, *arguments))
            if name in self.broken:
                raise RuntimeError(f"{name} is broken")

        return call

    def warnings(self) -> tuple[Fault, ...]:
        if "warnings" in self.broken:
            raise RuntimeError("the session is closed")
        return self.faults

    def loop(self, core: ScriptedCore, inbox: Inbox, link: ExecutorLink, *others: Any) -> Loop:
        """Returns a loop whose actions are calls of this object; for the other arguments see `Loop`."""
        all_calls: Any = self
        services = Services(inbox, all_calls, all_calls, all_calls, all_calls, self.warnings, self.fatal)
        return Loop(core, link, all_calls, services, *others)  # type: ignore[arg-type]
