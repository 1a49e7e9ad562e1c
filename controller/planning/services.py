"""What the loop needs from its surroundings, as protocols."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol

from controller.planning.core.events import Action, Event, Payload, PublishResult, Record
from controller.planning.core.tasks import Task
from controller.program import Fault


class Core(Protocol):
    """The planner's core; see `controller.planning.core`."""

    @property
    def ended(self) -> bool:
        """Whether `Quit` was carried out."""

    def step(self, event: Event, now: float, wall: float) -> Sequence[Action]:
        """Accepts an event at a time [s], and a time [UNIX s]; returns the actions in order."""


class Workers(Protocol):
    """Carry out tasks, and post `Answered`; no method waits."""

    def start(self, number: int, task: Task) -> None:
        """Starts a task."""

    def abandon(self, number: int) -> None:
        """Ends a task soon."""


class Ledger(Protocol):
    """Writes records, and posts `Recorded`; no method waits."""

    def record(self, record: Record) -> None:
        """Records a goal or its result."""

    def counts(self, counts: Sequence[int]) -> None:
        """Records the counts of all actuators."""


class Out(Protocol):
    """Publishes payloads; no method waits."""

    def publish(self, key: Literal["state", "diagnostics", "feedback"], payload: Payload) -> None:
        """Publishes a payload."""

    def publish_result(self, result: PublishResult) -> None:
        """Publishes a result, notes it, and posts `Published`."""


class Notifications(Protocol):
    """Notifies systemd."""

    def send(self, assignment: str) -> None:
        """Sends an assignment."""


class Services(NamedTuple):
    """What carries out the core's actions.

    Attributes:
        workers: of the tasks.
        ledger: of goals and switches.
        out: sends publications.
        notifier: notifies systemd.
        warnings: returns the active warnings of the clock, the network and the ledger.
        fatal: ends the process with a message.
    """

    workers: Workers
    ledger: Ledger
    out: Out
    notifier: Notifications
    warnings: Callable[[], tuple[Fault, ...]]
    fatal: Callable[[str], None]
