"""An executor that the test plays: it says what an executor says, and the test decides when. What clients hear."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from hyperbit.controller.planning.core.events import FromExecutor
from hyperbit.controller.program import (
    Accepted,
    Answer,
    Begun,
    Cancel,
    Declined,
    Down,
    Ended,
    Program,
    Settled,
    Snapshot,
    Up,
    Welcome,
    pack,
)
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refused

if TYPE_CHECKING:
    from tests.planning.rig.desk import Desk

T = TypeVar("T", bound=Down)


class PlayedExecutor(ABC):
    """The executor, played by the test.

    Attributes:
        state: the latest snapshot; `show` changes and sends it.
    """

    def __init__(self, actuators: int) -> None:
        self.actuators, self.instance = actuators, 1
        full, none = (1 << actuators) - 1, bytes((actuators + 7) // 8)
        known = pack(full, actuators)
        self.state = Snapshot(self.now(), "ready", "holding", 1, none, none, known, known, none, False, 0.0, -1, -1, ())
        self._results = 0

    @abstractmethod
    def now(self) -> float:
        """Returns the time [s]."""

    @abstractmethod
    def send(self, message: Up) -> None:
        """Sends a message to the planner."""

    @abstractmethod
    def take(self) -> Down | None:
        """Returns the next message of the planner; None if none comes."""

    @abstractmethod
    def waiting(self) -> Sequence[Down]:
        """Returns the messages that `take` has not returned yet."""

    def expect(self, kind: type[T], *passing: type[Any]) -> T:
        """Returns the next message and checks its kind; messages of kind `passing` are skipped."""
        while (message := self.take()) is not None:
            if isinstance(message, kind):
                return message
            assert isinstance(message, passing), f"{message} came where {kind.__name__} was expected"
        raise AssertionError(f"no {kind.__name__} came")

    def nothing(self, kind: type[Any]) -> bool:
        return not any(isinstance(message, kind) for message in self.waiting())

    def show(self, **changes: Any) -> None:
        """Sends a snapshot; an integer sets `outputs`, and the measured states as well."""
        if isinstance(bits := changes.get("outputs"), int):
            changes["outputs"] = pack(bits, self.actuators)
        if "outputs" in changes and "measured" not in changes:
            changes["measured"] = changes["outputs"]
        self.state = msgspec.structs.replace(self.state, at=self.now(), **changes)
        self.send(self.state)

    def answer(self, message: Any, text: str, accepted: bool = True, **changes: Any) -> None:
        """Answers a request as the executor does: it begins a new epoch if needed, and sends a snapshot."""
        ends = not isinstance(message, Cancel) or message.program is None
        refused = None if accepted else Refused(Reason.INTERLOCK_OPEN, {"interlock": text})
        self.send(Answer(message.request, text, refused))
        self.show(epoch=self.state.epoch + (ends and accepted), **changes)

    def accept(self, program: Program) -> None:
        self.send(Accepted(program.program, program.begin or self.now()))
        self.show(mode="executing", reason=program.name, program=program.program)

    def decline(self, program: Program, reason: Reason, **facts: str) -> None:
        self.send(Declined(program.program, Refused(reason, facts)))

    def run(self, program: Program, stage: int, switches: int = 1, measured: bytes | None = None) -> None:
        states = program.stages[stage]
        self.send(Begun(program.program, stage, switches))
        self.show(outputs=states.states, measured=measured or states.states)
        if states.mark >= 0:
            at = measured or states.states
            self.send(Settled(program.program, states.mark, at, self.state.known, switches, 1, True))

    def end(self, program: Program, status: Any = "done", message: str = "done", **fields: Any) -> Ended:
        """Ends a program; `fields` are those of Ended that differ from what the program asked for."""
        self._results += 1
        usual = {"mark": program.stages[-1].mark, "switches": 1, "travels": (), "verified": True}
        usual |= {"measured": self.state.measured, "known": self.state.known}
        ended = Ended(self._results, program.program, program.context, status, message, **{**usual, **fields})
        self.send(ended)
        self.show(mode="ready", reason=f"holding; {program.name} ended", program=-1)
        return ended


class DeskExecutor(PlayedExecutor):
    """The executor of a desk.

    Attributes:
        messages: of the planner, but keep-alives and counts.
    """

    def __init__(self, desk: Desk, actuators: int) -> None:
        self._desk, self.messages = desk, deque[Down]()
        super().__init__(actuators)

    def greet(self, greatest: int = 0) -> None:
        self.send(Welcome("small", "d" * 64, self.instance, (0,) * self.actuators, greatest, self._desk.simulation))
        self.show()

    def now(self) -> float:
        return self._desk.now

    def send(self, message: Up) -> None:
        self._desk.post(FromExecutor(message))

    def take(self) -> Down | None:
        return self.messages.popleft() if self.messages else None

    def waiting(self) -> deque[Down]:
        return self.messages


class Inbox:
    def __init__(self, said: list[tuple[str, Any]]) -> None:
        self.payloads = deque[tuple[str, dict[str, Any]]]()
        self._said = said

    def put(self, key: str, payload: Any) -> None:
        self.payloads.append((key, dict(payload)))
        self._said.append((key, dict(payload)))

    def next(self, key: str) -> dict[str, Any]:
        assert self.payloads, f"no {key} came"
        came, payload = self.payloads.popleft()
        assert came == key, f"{came} {payload} came where {key} was expected"
        return payload

    @property
    def empty(self) -> bool:
        return not self.payloads
